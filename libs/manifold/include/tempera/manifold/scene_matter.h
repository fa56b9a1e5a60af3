// SPDX-License-Identifier: Apache-2.0
#pragma once
// The matter of a scene for chains through its mirrors and glass: rays find which primitive is met, which is then crossed
// in double. Rough surfaces of the events R and T are taken for smooth ones. What lets at least half of the light pass
// straight on (opacity below 0.5) is not there.
#include <functional>
#include <vector>

#include "tempera/manifold/specular_walk.h"

namespace tempera {

/// Threads: one thread each.
class SceneMatter final : public ChainMatter {
 public:
  /// What rays of the first edge see: between these distances, and only what cameras may see.
  struct Range {
    double tmin = 0, tmax = 0;
  };
  /// `rays_at`: what rays of a time meet. `first_range`: from where on the first edge, from o in unit direction d, looks.
  SceneMatter(std::function<const RayScene&(double t)> rays_at,
              std::function<Range(const Vec3d& o, const Vec3d& d, double t)> first_range)
      : rays_at_(std::move(rays_at)), first_range_(std::move(first_range)) {}

  std::optional<Crossing> meet(const Vec3d& o, const Vec3d& d, double t, const ChainVertex* from) const override;
  /// What it meets as rays have it, in float; the distance is from `o`.
  std::optional<Hit> first_hit(const Vec3d& o, const Vec3d& d, double t, const ChainVertex* from) const;
  SurfaceFrame surface(const Crossing& at, double t) const override {
    return rays_at_(t).surface(at.point, at.u, at.v, t, &poses_);
  }
  /// Asks the material once for each shape and event: what it says elsewhere or later may differ where it has textures;
  /// find_bend knows. Empty for surfaces with perturbed normals, too.
  std::optional<double> eta(const Crossing& at, const SurfaceFrame& f, const Vec3d& wo, bool refracts,
                            double t) const override;

  /// What the surface makes of light that is seen from unit direction `wo`.
  enum class Does { kNothing, kBends, kPerturbed };
  struct Bend {
    Does does = Does::kNothing;
    double eta = 1;
  };
  /// `n`: its interpolated normal. kPerturbed: about another normal than that, of a bump or normal map.
  static Bend find_bend(const Bsdf& bsdf, const Vec3d& wo, const Vec3d& n, bool refracts);
  Bend find_bend(const Crossing& at, const SurfaceFrame& f, const Vec3d& wo, bool refracts, double t) const;
  /// Whether that may be another one at another point of the shape.
  static bool varies(const Material& material) { return material.needs_footprint(); }

  const RayScene& rays(double t) const { return rays_at_(t); }

 private:
  struct Known {
    std::uint32_t shape;
    bool refracts, front;
    Bend bend;
  };
  std::function<const RayScene&(double t)> rays_at_;
  std::function<Range(const Vec3d& o, const Vec3d& d, double t)> first_range_;
  std::optional<Hit> find_hit(const RayScene& rays, const Vec3d& start, Ray ray, const ChainVertex* from) const;
  /// A ray along the first edge or from a vertex, and where along the line from o its start is.
  Ray ray_of(const RayScene& rays, const Vec3d& o, const Vec3d& d, double t, const ChainVertex* from,
             double& start) const;
  mutable std::vector<Known> known_;
  mutable PoseCache poses_;
};

}  // namespace tempera
