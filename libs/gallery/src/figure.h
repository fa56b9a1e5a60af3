// SPDX-License-Identifier: Apache-2.0
#pragma once
// A figure of a person with a skeleton: a skinned mesh made from blended solids, and the poses of a run.
// It faces +z, y up, its left side at +x; its feet stand on y = 0.
#include <array>
#include <vector>

#include "builder.h"

namespace tempera::gallery {

/// Joints, parents before children.
enum Joint : int {
  kHips,
  kSpine,
  kChest,
  kNeck,
  kHead,
  kUpperArmL,
  kForearmL,
  kHandL,
  kUpperArmR,
  kForearmR,
  kHandR,
  kThighL,
  kShinL,
  kFootL,
  kThighR,
  kShinR,
  kFootR,
  kJointCount,
};
const char* joint_name(Joint joint);
/// -1 for the hips.
int joint_parent(Joint joint);
/// Where a joint is at bind time.
Vec3d joint_position(Joint joint);

/// Parts of the body that get a material each.
enum BodyPart : int { kSkin, kShirt, kShorts, kShoes, kHair, kBodyPartCount };
/// The skinned mesh at bind time; `cell` is the edge of the grid that it is made on, in metres.
std::array<Polygons, kBodyPartCount> figure_polygons(double cell);

/// Rotations of all joints in world space, and where the hips are.
struct Pose {
  Vec3d hips;
  std::array<Quatd, kJointCount> world;
  /// Rotation of a joint against its parent.
  Quatd local(Joint joint) const;
};

/// How a figure runs: the feet stand still on the ground while they carry it.
struct Run {
  double seconds_per_stride = 0.66;                                       ///< two steps
  double contact = 0.32;                                                  ///< part of the stride that a foot stands
  double step = 0.75;                                                     ///< metres that the body goes meanwhile
  double speed() const { return step / (contact * seconds_per_stride); }  ///< m/s
  /// The pose after `seconds`, running along +z from the origin.
  Pose at(double seconds) const;
};

/// Puts the figure into the scene: its joints, its skin and its mesh, moved by `pose` (a function of the frame).
void place_figure(GalleryBuilder& b, const std::string& name, const std::array<int, kBodyPartCount>& materials,
                  double cell, const std::function<Pose(double frame)>& pose);

}  // namespace tempera::gallery
