// SPDX-License-Identifier: Apache-2.0
#include "figure.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>

#include "tempera/gallery/implicit.h"

namespace tempera::gallery {

namespace {

struct JointInfo {
  const char* name;
  int parent;
  Vec3d position;
};
constexpr Vec3d mirrored(const Vec3d& p) { return {-p.x, p.y, p.z}; }
constexpr Vec3d kShoulder{0.185, 1.445, -0.01}, kElbow{0.355, 1.205, -0.02}, kWrist{0.495, 0.995, 0.0},
    kFingers{0.585, 0.855, 0.01}, kHip{0.09, 0.93, 0}, kKnee{0.10, 0.50, 0.012}, kAnkle{0.105, 0.085, -0.012},
    kToes{0.112, 0.03, 0.155};
constexpr JointInfo kJoints[kJointCount] = {
    {"hips", -1, {0, 0.95, 0}},
    {"spine", kHips, {0, 1.06, 0}},
    {"chest", kSpine, {0, 1.24, 0}},
    {"neck", kChest, {0, 1.49, -0.01}},
    {"head", kNeck, {0, 1.58, 0.01}},
    {"upper_arm_l", kChest, kShoulder},
    {"forearm_l", kUpperArmL, kElbow},
    {"hand_l", kForearmL, kWrist},
    {"upper_arm_r", kChest, mirrored(kShoulder)},
    {"forearm_r", kUpperArmR, mirrored(kElbow)},
    {"hand_r", kForearmR, mirrored(kWrist)},
    {"thigh_l", kHips, kHip},
    {"shin_l", kThighL, kKnee},
    {"foot_l", kShinL, kAnkle},
    {"thigh_r", kHips, mirrored(kHip)},
    {"shin_r", kThighR, mirrored(kKnee)},
    {"foot_r", kShinR, mirrored(kAnkle)},
};

/// Distance to the part of the body that moves with a joint. Limbs are given for the left side.
double part(int joint, const Vec3d& q) {
  const bool right = joint == kUpperArmR || joint == kForearmR || joint == kHandR || joint == kThighR ||
                     joint == kShinR || joint == kFootR;
  const Vec3d p = right ? mirrored(q) : q;
  switch (joint) {
    case kHips: {
      const double pelvis = ellipsoid(p - Vec3d{0, 0.965, 0.0}, {0.160, 0.125, 0.112});
      const Vec3d folded{std::abs(p.x), p.y, p.z};
      return blend(pelvis, ball(folded, {0.078, 0.925, -0.045}, 0.088), 0.05);
    }
    case kSpine:
      return ellipsoid(p - Vec3d{0, 1.12, 0.0}, {0.138, 0.15, 0.098});
    case kChest: {
      const Vec3d folded{std::abs(p.x), p.y, p.z};
      const double ribs = ellipsoid(p - Vec3d{0, 1.30, -0.002}, {0.165, 0.19, 0.112});
      const double shoulders = limb(folded, {0.02, 1.445, -0.012}, kShoulder, 0.075, 0.060);
      const double breast = ellipsoid(folded - Vec3d{0.075, 1.36, 0.055}, {0.085, 0.07, 0.055});
      return blend(blend(ribs, shoulders, 0.07), breast, 0.04);
    }
    case kNeck:
      return limb(p, {0, 1.47, -0.012}, {0, 1.60, 0.005}, 0.060, 0.052);
    case kHead: {
      const double skull = ellipsoid(p - Vec3d{0, 1.695, 0.012}, {0.075, 0.098, 0.094});
      const double jaw = ellipsoid(p - Vec3d{0, 1.635, 0.045}, {0.052, 0.065, 0.062});
      const double nose = limb(p, {0, 1.69, 0.098}, {0, 1.662, 0.112}, 0.009, 0.013);
      const Vec3d folded{std::abs(p.x), p.y, p.z};
      const double ear = ellipsoid(folded - Vec3d{0.076, 1.675, 0.005}, {0.012, 0.028, 0.02});
      return blend(blend(blend(skull, jaw, 0.05), nose, 0.02), ear, 0.012);
    }
    case kUpperArmL:
    case kUpperArmR:
      return blend(limb(p, kShoulder, kElbow, 0.052, 0.038), ball(p, kShoulder + Vec3d{0.012, -0.01, 0}, 0.064), 0.05);
    case kForearmL:
    case kForearmR: {
      const Vec3d thick = lerp(kElbow, kWrist, 0.25f);
      return blend(limb(p, kElbow, thick, 0.037, 0.043), limb(p, thick, kWrist, 0.043, 0.026), 0.02);
    }
    case kHandL:
    case kHandR: {
      const Vec3d palm = lerp(kWrist, kFingers, 0.45f);
      const double fist = ellipsoid(p - palm, {0.036, 0.05, 0.042});
      return blend(fist, limb(p, kWrist, palm, 0.026, 0.03), 0.02);
    }
    case kThighL:
    case kThighR: {
      const Vec3d middle = lerp(kHip, kKnee, 0.35f) + Vec3d{0.004, 0, 0.012};
      return blend(limb(p, kHip, middle, 0.085, 0.083), limb(p, middle, kKnee, 0.083, 0.056), 0.03);
    }
    case kShinL:
    case kShinR: {
      const Vec3d calf{0.104, 0.36, -0.026};
      return blend(limb(p, kKnee, calf, 0.055, 0.058), limb(p, calf, kAnkle, 0.058, 0.036), 0.03);
    }
    default: {  // feet
      const double shoe = blend(limb(p, kAnkle - Vec3d{0.002, 0.035, 0.03}, kToes, 0.046, 0.036),
                                limb(p, kAnkle, kAnkle + Vec3d{0.002, -0.03, 0.05}, 0.042, 0.045), 0.03);
      return carve(shoe, p.y - 0.004, 0.01);
    }
  }
}

double body(const Vec3d& p) {
  // Wide blends within the trunk, narrow ones where limbs join, and none between limbs.
  double trunk = blend(blend(part(kHips, p), part(kSpine, p), 0.10), part(kChest, p), 0.08);
  trunk = blend(trunk, part(kNeck, p), 0.04);
  const double head = part(kHead, p);
  double all = blend(trunk, head, 0.025);
  for (const auto& [upper, lower, end] :
       {std::array{kUpperArmL, kForearmL, kHandL}, std::array{kUpperArmR, kForearmR, kHandR}})
    all = blend(all, blend(blend(part(upper, p), part(lower, p), 0.02), part(end, p), 0.02), 0.035);
  for (const auto& [upper, lower, end] : {std::array{kThighL, kShinL, kFootL}, std::array{kThighR, kShinR, kFootR}})
    all = blend(all, blend(blend(part(upper, p), part(lower, p), 0.025), part(end, p), 0.03), 0.035);
  return all;
}

/// What a point of the skin wears, at bind time.
BodyPart clothing(const Vec3d& p) {
  const Vec3d left{std::abs(p.x), p.y, p.z};  // both sides wear the same
  if (part(kFootL, left) < 0.004 && p.y < 0.105) return kShoes;
  if (p.y > 1.55) {
    // Short hair: above a slanted line from the brow to the nape.
    return p.y - 1.70 > 0.9 * (p.z - 0.062) && p.y > 1.635 ? kHair : kSkin;
  }
  if (p.y > 1.04 && left.x < kShoulder.x) {
    const double neckline = (left.x > 0.06 ? 1.55 : 1.49) - 0.25 * left.x;
    return p.y < neckline ? kShirt : kSkin;
  }
  if (p.y > 1.15) {
    const double sleeve = dot(left - kShoulder, normalize(kElbow - kShoulder));
    return sleeve < 0.13 ? kShirt : kSkin;
  }
  return p.y > 0.67 && left.x < 0.25 ? kShorts : kSkin;
}

Quatd from_to(const Vec3d& a, const Vec3d& b) {  // the shortest turn; pre: not opposite
  const Vec3d u = normalize(a), v = normalize(b), c = cross(u, v);
  return normalize(Quatd{1 + dot(u, v), c.x, c.y, c.z});
}

Quatd inverse_of(const Quatd& q) { return {q.w, -q.x, -q.y, -q.z}; }
Vec3d turn(const Quatd& q, const Vec3d& v) { return rotation(q).vector(v); }

/// Cubic through periodic keys (phase, value), slopes by neighbors.
double periodic(std::span<const Vec2d> keys, double phase) {
  const std::size_t n = keys.size();
  phase -= std::floor(phase);
  const auto key = [&](std::ptrdiff_t i) {
    const auto m = std::ptrdiff_t(n);
    const std::ptrdiff_t wrapped = ((i % m) + m) % m;
    return Vec2d{keys[wrapped].x + double((i - wrapped) / m), keys[wrapped].y};
  };
  std::ptrdiff_t i = std::ptrdiff_t(n) - 1;
  while (i >= 0 && key(i).x > phase) --i;
  const Vec2d a = key(i - 1), b = key(i), c = key(i + 1), d = key(i + 2);
  const double h = c.x - b.x, t = (phase - b.x) / h, mb = (c.y - a.y) / (c.x - a.x) * h,
               mc = (d.y - b.y) / (d.x - b.x) * h;
  const double t2 = t * t, t3 = t2 * t;
  return (2 * t3 - 3 * t2 + 1) * b.y + (t3 - 2 * t2 + t) * mb + (3 * t2 - 2 * t3) * c.y + (t3 - t2) * mc;
}

}  // namespace

const char* joint_name(Joint joint) { return kJoints[joint].name; }
int joint_parent(Joint joint) { return kJoints[joint].parent; }
Vec3d joint_position(Joint joint) { return kJoints[joint].position; }

std::array<Polygons, kBodyPartCount> figure_polygons(double cell) {
  Polygons whole = polygonize(body, {-0.68, -0.02, -0.20}, {0.68, 1.82, 0.24}, cell);
  // Weights fall off over 2 cm from the part of the body that a vertex belongs to.
  whole.joints.resize(whole.positions.size());
  whole.weights.resize(whole.positions.size());
  for (std::size_t v = 0; v < whole.positions.size(); ++v) {
    const Vec3d p(whole.positions[v]);
    std::array<std::pair<double, int>, kJointCount> near;
    for (int j = 0; j < kJointCount; ++j) near[j] = {part(j, p), j};
    std::sort(near.begin(), near.end());
    double sum = 0;
    std::array<double, 4> w;
    for (std::size_t k = 0; k < 4; ++k) sum += w[k] = std::exp(-(near[k].first - near[0].first) / 0.02);
    for (std::size_t k = 0; k < 4; ++k) {
      whole.joints[v][k] = std::uint16_t(near[k].second);
      whole.weights[v][k] = float(w[k] / sum);
    }
  }
  std::array<Polygons, kBodyPartCount> out;
  std::array<std::vector<std::int32_t>, kBodyPartCount> moved;
  for (auto& m : moved) m.assign(whole.positions.size(), -1);
  for (std::size_t t = 0; t < whole.indices.size(); t += 3) {
    Vec3d center{};
    for (std::size_t c = 0; c < 3; ++c) center += Vec3d(whole.positions[whole.indices[t + c]]) / 3;
    const auto which = std::size_t(clothing(center));
    Polygons& to = out[which];
    for (std::size_t c = 0; c < 3; ++c) {
      const std::uint32_t v = whole.indices[t + c];
      if (moved[which][v] < 0) {
        moved[which][v] = std::int32_t(to.vertex(Vec3d(whole.positions[v]), Vec3d(whole.normals[v]), {}));
        to.joints.push_back(whole.joints[v]);
        to.weights.push_back(whole.weights[v]);
      }
      to.indices.push_back(std::uint32_t(moved[which][v]));
    }
  }
  return out;
}

Quatd Pose::local(Joint joint) const {
  const int parent = kJoints[joint].parent;
  return parent < 0 ? world[joint] : inverse_of(world[parent]) * world[joint];
}

Pose Run::at(double seconds) const {
  const double stride = seconds / seconds_per_stride, degree = kPiD / 180;
  Pose pose;
  const double wave = 2 * kPiD * stride;
  // Two bounces a stride: lowest when a foot passes below the body, highest in flight.
  const double lowest = contact / 2;
  pose.hips = {0.012 * std::sin(wave - 2 * kPiD * lowest), 0.885 - 0.028 * std::cos(2 * (wave - 2 * kPiD * lowest)),
               speed() * seconds};
  const double yaw = 7 * std::sin(wave + 0.6), lean = 8;
  auto& w = pose.world;
  w[kHips] = about_x(lean * 0.5) * about_y(yaw) * about_z(3 * std::sin(wave - 1.0));
  w[kSpine] = about_x(lean) * about_y(-0.2 * yaw);
  w[kChest] = about_x(lean * 1.1) * about_y(-1.6 * yaw);
  w[kNeck] = about_x(lean * 0.8) * about_y(-0.4 * yaw);
  w[kHead] = about_x(lean * 0.35);

  const auto leg = [&](double phase, double side, Joint thigh, Joint shin, Joint foot) {
    phase -= std::floor(phase);
    const Vec3d hip = pose.hips + turn(w[kHips], Vec3d{side * kHip.x, kHip.y, kHip.z} - kJoints[kHips].position);
    // The ankle against the hips: over the ground at the body's speed backwards, then lifted and thrown forwards.
    const double front = 0.29, back = front - step;
    const std::array<Vec2d, 8> z{{{0, front},
                                  {contact * 0.5, front - step * 0.5},
                                  {contact, back},
                                  {0.42, back - 0.13},
                                  {0.55, -0.33},
                                  {0.70, 0.10},
                                  {0.84, 0.41},
                                  {0.93, 0.40}}};
    const std::array<Vec2d, 8> y{{{0, 0.085},
                                  {contact * 0.5, 0.082},
                                  {contact, 0.165},
                                  {0.42, 0.36},
                                  {0.55, 0.53},
                                  {0.70, 0.43},
                                  {0.84, 0.25},
                                  {0.93, 0.135}}};
    const std::array<Vec2d, 8> pitch{
        {{0, -10}, {0.08, 0}, {0.2, 4}, {contact, 48}, {0.44, 78}, {0.6, 62}, {0.78, 10}, {0.92, -14}}};
    double ankle_z = periodic(z, phase), ankle_y = periodic(y, phase);
    if (phase < contact) ankle_z = front - step * phase / contact;
    Vec3d ankle{side * (0.06 + 0.02 * (phase > contact)), ankle_y, pose.hips.z + ankle_z};
    // Two bones of known length from the hip to the ankle, the knee in front.
    const double a = length(kKnee - kHip), c = length(kAnkle - kKnee);
    Vec3d to = ankle - hip;
    const double reach = std::min(length(to), 0.998 * (a + c));
    to = normalize(to);
    ankle = hip + to * reach;
    const double angle = std::acos(std::clamp((a * a + reach * reach - c * c) / (2 * a * reach), -1.0, 1.0));
    const Vec3d forward = normalize(Vec3d{side * 0.06, 0, 1} - to * dot(Vec3d{side * 0.06, 0, 1}, to));
    const Vec3d knee = hip + to * (a * std::cos(angle)) + forward * (a * std::sin(angle));
    const auto own = [&](const Vec3d& v) { return side > 0 ? v : mirrored(v); };
    w[thigh] = from_to(own(kKnee - kHip), knee - hip);
    w[shin] = from_to(own(kAnkle - kKnee), ankle - knee);
    w[foot] = about_x(periodic(pitch, phase));
  };
  leg(stride, 1, kThighL, kShinL, kFootL);
  leg(stride + 0.5, -1, kThighR, kShinR, kFootR);

  const auto arm = [&](double phase, double side, Joint upper, Joint fore, Joint hand) {
    const double swing = std::sin(2 * kPiD * phase);  // forwards when the leg of this side is behind
    const double angle = (-12 + 42 * swing) * degree, bend = (98 + 14 * swing) * degree;
    const Vec3d u = turn(w[kChest], normalize(Vec3d{side * (0.22 - 0.05 * swing), -std::cos(angle), std::sin(angle)}));
    const Vec3d f = turn(w[kChest], normalize(Vec3d{side * (-0.05 - 0.28 * std::max(swing, 0.0)),
                                                    -std::cos(angle + bend), std::sin(angle + bend)}));
    const auto own = [&](const Vec3d& v) { return side > 0 ? v : mirrored(v); };
    w[upper] = from_to(own(kElbow - kShoulder), u);
    w[fore] = from_to(own(kWrist - kElbow), f);
    w[hand] = w[fore];
  };
  arm(stride + 0.25 + contact, 1, kUpperArmL, kForearmL, kHandL);
  arm(stride + 0.75 + contact, -1, kUpperArmR, kForearmR, kHandR);
  return pose;
}

void place_figure(GalleryBuilder& b, const std::string& name, const std::array<int, kBodyPartCount>& materials,
                  double cell, const std::function<Pose(double frame)>& pose) {
  std::array<Polygons, kBodyPartCount> polygons = figure_polygons(cell);
  std::vector<Glb::Part> parts;
  for (std::size_t i = 0; i < kBodyPartCount; ++i) {
    if (!polygons[i].indices.empty()) parts.push_back({std::move(polygons[i]), materials[i]});
  }
  const int mesh = b.glb().mesh(name, parts);
  std::vector<int> joints;
  std::vector<Affine3d> inverse_bind;
  for (int j = 0; j < kJointCount; ++j) {
    const JointInfo& info = kJoints[j];
    const Vec3d from = info.parent < 0 ? Vec3d{} : kJoints[info.parent].position;
    joints.push_back(
        b.group(name + "_" + info.name, info.position - from, {}, info.parent < 0 ? -1 : joints[info.parent]));
    inverse_bind.push_back(at(-info.position));
    b.turn(joints.back(), [&](double f) { return pose(f).local(Joint(j)); });
  }
  b.move(joints[0], [&](double f) { return pose(f).hips; });
  const int skin = b.glb().skin(joints, inverse_bind);
  b.glb().node({.name = name, .mesh = mesh, .skin = skin});
}

}  // namespace tempera::gallery
