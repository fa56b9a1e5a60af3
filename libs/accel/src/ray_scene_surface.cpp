// SPDX-License-Identifier: Apache-2.0
// Points of surfaces at any time: what shading, light samples and motion vectors ask for.
#include "ray_scene_impl.h"
#include "tempera/core/error.h"

namespace tempera {

Affine3f RayScene::Impl::world(std::uint32_t instance, double t) const {
  const InstanceMotion& m = motions[instance];
  if (!m.moves) return m.world;
  const auto [knot, blend] = locate(t);
  return blend == 0 ? compose(m.knots[knot]) : interpolate(m.knots[knot], m.knots[knot + 1], blend);
}

RayScene::Impl::Triangle RayScene::Impl::knot_triangle(const PlacedShape& p, std::uint32_t primitive,
                                                       std::size_t knot) const {
  Triangle t;
  const Mesh& mesh = *p.mesh;
  t.smooth = !mesh.normals.empty();
  const bool in_memory = knot >= p.first_knot && knot - p.first_knot < p.knots.size();
  for (int c = 0; c < 3; ++c) {
    const std::uint32_t v = mesh.corners(primitive)[c];
    if (in_memory) {
      const KnotVertices& k = p.knots[knot - p.first_knot];
      t.p[c] = k.positions[v];
      if (t.smooth) t.n[c] = k.normals[v];
    } else {  // outside the span of rays: the same function that filled the buffers, for three vertices
      t.p[c] = posed_position(mesh, p.poses[knot], v);
      if (t.smooth) t.n[c] = posed_normal(mesh, p.poses[knot], v);
    }
  }
  return t;
}

RayScene::Impl::Triangle RayScene::Impl::blended_triangle(const PlacedShape& p, std::uint32_t primitive,
                                                          double time) const {
  const auto [knot, blend] = locate(time);
  Triangle a = knot_triangle(p, primitive, knot);
  if (blend == 0) return a;
  const Triangle b = knot_triangle(p, primitive, knot + 1);
  for (int c = 0; c < 3; ++c) {
    a.p[c] = lerp(a.p[c], b.p[c], blend);
    if (a.smooth) a.n[c] = normalize(lerp(a.n[c], b.n[c], blend));
  }
  return a;
}

TEMPERA_INLINE RayScene::Impl::Triangle RayScene::Impl::triangle(const PlacedShape& p, std::uint32_t primitive,
                                                                 double time) const {
  if (p.placement == Placement::kDeforming) return blended_triangle(p, primitive, time);
  const std::uint32_t* v = p.mesh->corners(primitive);
  const KnotVertices& k = p.knots[0];
  if (!k.normals) return {{k.positions[v[0]], k.positions[v[1]], k.positions[v[2]]}, {}, false};
  return {{k.positions[v[0]], k.positions[v[1]], k.positions[v[2]]},
          {k.normals[v[0]], k.normals[v[1]], k.normals[v[2]]},
          true};
}

bool RayScene::Impl::mirrored(const PlacedShape& p, double t) const {
  if (!p.mirroring_changes) return p.mirrored;
  // Vertices are linear between knots, so their map is, too.
  const auto [knot, blend] = locate(t);
  const Affine3f& a = p.poses[knot].world;
  if (blend == 0) return a.determinant() < 0;
  const Affine3f& b = p.poses[knot + 1].world;
  return Affine3f{lerp(a.x, b.x, blend), lerp(a.y, b.y, blend), lerp(a.z, b.z, blend)}.determinant() < 0;
}

namespace {

/// Derivatives of functions that are linear over a triangle (values at its corners) with respect to its uv coordinates.
struct UvGradient {
  float a = 0, b = 0, c = 0, d = 0;  // d/du = a e1 + b e2, d/dv = c e1 + d e2 for edges e1, e2 from corner 0
  bool usable = false;
  explicit UvGradient(const Vec2f (&uv)[3]) {
    const Vec2f d1 = uv[1] - uv[0], d2 = uv[2] - uv[0];
    const float inv = 1 / (d1.x * d2.y - d1.y * d2.x);
    usable = std::isfinite(inv);
    if (usable) a = d2.y * inv, b = -d1.y * inv, c = -d2.x * inv, d = d1.x * inv;
  }
  Vec3f du(const Vec3f (&v)[3]) const { return (v[1] - v[0]) * a + (v[2] - v[0]) * b; }
  Vec3f dv(const Vec3f (&v)[3]) const { return (v[1] - v[0]) * c + (v[2] - v[0]) * d; }
};

/// Texture coordinates of a triangle's corners; its barycentrics where the mesh has none.
void corner_uvs(const Mesh& mesh, const std::uint32_t* v, Vec2f (&uv)[3]) {
  uv[0] = {0, 0}, uv[1] = {1, 0}, uv[2] = {0, 1};
  if (mesh.uvs.empty()) return;
  for (int c = 0; c < 3; ++c) uv[c] = mesh.uvs[v[c]];
}

}  // namespace

ShadingPoint RayScene::shading_point(const SurfacePoint& point, double t, const Vec3f& wo) const {
  const Impl& s = *impl_;
  const PlacedShape& placed = s.find(point.instance, point.shape);
  ShadingPoint r;
  r.wo = wo;
  r.time = t;
  Vec3f ns;  // interpolated, not yet unit
  Vec3f tangent{};
  float tangent_sign = 1;
  bool flip = false;
  if (placed.mesh) {
    const Mesh& mesh = *placed.mesh;
    const Impl::Triangle tri = s.triangle(placed, point.primitive, t);
    const float b0 = 1 - point.u - point.v, b1 = point.u, b2 = point.v;
    r.p = tri.p[0] * b0 + tri.p[1] * b1 + tri.p[2] * b2;
    r.ng = normalize(cross(tri.p[1] - tri.p[0], tri.p[2] - tri.p[0]) * (s.mirrored(placed, t) ? -1.0f : 1.0f));
    const std::uint32_t* v = mesh.corners(point.primitive);
    const auto interpolated = [&](const auto& values) {
      return values[v[0]] * b0 + values[v[1]] * b1 + values[v[2]] * b2;
    };
    r.uv = mesh.uvs.empty() ? Vec2f{b1, b2} : interpolated(mesh.uvs);
    r.uv1 = mesh.uvs1.empty() ? r.uv : interpolated(mesh.uvs1);
    ns = r.ng;
    if (tri.smooth) {
      ns = tri.n[0] * b0 + tri.n[1] * b1 + tri.n[2] * b2;
      const float l = length(ns);
      ns = l > 0 ? ns * (1 / l) : r.ng;
    }
    if (!mesh.colors.empty()) {
      if (mesh.color_per_face) {
        r.color = mesh.colors[point.primitive];
        if (!mesh.color_alphas.empty()) r.color_alpha = mesh.color_alphas[point.primitive];
      } else {
        r.color = interpolated(mesh.colors);
        if (!mesh.color_alphas.empty()) r.color_alpha = interpolated(mesh.color_alphas);
      }
    }
    if (placed.tangents) {
      Vec2f uv[3];
      corner_uvs(mesh, v, uv);
      if (const UvGradient g(uv); g.usable) {
        r.dpdu = g.du(tri.p), r.dpdv = g.dv(tri.p);
      } else {
        const Basis b(r.ng);
        r.dpdu = b.s, r.dpdv = b.t;
      }
      if (!mesh.tangents.empty()) {
        tangent = interpolated(mesh.tangents);
        if (!mesh.tangent_signs.empty()) tangent_sign = mesh.tangent_signs[v[0]];
        // Tangents are stored in the mesh's bind space; deformation turns them with dpdu, which is close enough for the
        // in-plane direction of a normal map.
        if (placed.placement == Placement::kDeforming && dot(r.dpdu, r.dpdu) > 0 && !mesh.uvs.empty()) tangent = r.dpdu;
      }
    }
    flip = mesh.flip_normals;
  } else {
    const analytic::UnitPoint<float> unit = analytic::evaluate(placed.analytic.kind, point.u, point.v);
    const Affine3f& m = placed.analytic.object_from_unit;
    r.p = m.point(unit.p);
    r.uv = r.uv1 = {point.u, point.v};
    if (placed.tangents) r.dpdu = m.vector(unit.dpdu), r.dpdv = m.vector(unit.dpdv);
    ns = r.ng = normalize(placed.unit_from_object.transposed_vector(unit.n));
    flip = placed.analytic.flip_normals;
  }
  if (placed.placement == Placement::kInstanced) {
    const Affine3f m = s.world(point.instance, t);
    r.p = m.point(r.p);
    r.ng = transform_normal(m, r.ng);
    ns = transform_normal(m, ns);
    if (placed.tangents) {
      r.dpdu = m.vector(r.dpdu);
      r.dpdv = m.vector(r.dpdv);
      tangent = m.vector(tangent);
    }
  }
  if (flip) {
    r.ng = -r.ng;
    ns = -ns;
  }
  if (placed.tangents) {
    const bool has_tangent = tangent.x != 0 || tangent.y != 0 || tangent.z != 0;
    r.frame = Basis::with_tangent(ns, has_tangent ? tangent : r.dpdu);
    if (tangent_sign < 0) r.frame.t = -r.frame.t;
  } else {
    r.frame = Basis(ns);
  }
  if (scene_->bend_normals) {
    r.bends = true;
    r.unbent = ns;
  }
  return r;
}

SurfaceDerivatives RayScene::derivatives(const SurfacePoint& point, double t) const {
  const Impl& s = *impl_;
  const PlacedShape& placed = s.find(point.instance, point.shape);
  SurfaceDerivatives r;
  Vec3f n;  // shading normal, not yet unit; dndu and dndv are its derivatives until the end
  bool flip = false;
  if (placed.mesh) {
    const Impl::Triangle tri = s.triangle(placed, point.primitive, t);
    n = cross(tri.p[1] - tri.p[0], tri.p[2] - tri.p[0]) * (s.mirrored(placed, t) ? -1.0f : 1.0f);
    Vec2f uv[3];
    corner_uvs(*placed.mesh, placed.mesh->corners(point.primitive), uv);
    const UvGradient g(uv);
    if (g.usable) {
      r.dpdu = g.du(tri.p), r.dpdv = g.dv(tri.p);
    } else {
      const Basis b(normalize(n));
      r.dpdu = b.s, r.dpdv = b.t;
    }
    if (tri.smooth) {
      n = tri.n[0] * (1 - point.u - point.v) + tri.n[1] * point.u + tri.n[2] * point.v;
      if (g.usable) r.dndu = g.du(tri.n), r.dndv = g.dv(tri.n);
    }
    flip = placed.mesh->flip_normals;
  } else {
    const analytic::UnitPoint<float> unit = analytic::evaluate(placed.analytic.kind, point.u, point.v);
    const Affine3f& m = placed.analytic.object_from_unit;
    const Affine3f& inv = placed.unit_from_object;
    r = {m.vector(unit.dpdu), m.vector(unit.dpdv), inv.transposed_vector(unit.dndu), inv.transposed_vector(unit.dndv)};
    n = inv.transposed_vector(unit.n);
    flip = placed.analytic.flip_normals;
  }
  if (placed.placement == Placement::kInstanced) {
    const Affine3f m = s.world(point.instance, t), inv = inverse(m);
    r = {m.vector(r.dpdu), m.vector(r.dpdv), inv.transposed_vector(r.dndu), inv.transposed_vector(r.dndv)};
    n = inv.transposed_vector(n);
  }
  const float l = length(n);
  if (!(l > 0)) return {r.dpdu, r.dpdv, {}, {}};
  n = n * ((flip ? -1 : 1) / l);
  const auto unit = [&](const Vec3f& dn) { return (dn - n * dot(n, dn)) * ((flip ? -1 : 1) / l); };
  r.dndu = unit(r.dndu);
  r.dndv = unit(r.dndv);
  return r;
}

Vec3f RayScene::position(const SurfacePoint& point, double t, Vec3f* ng) const {
  const Impl& s = *impl_;
  const PlacedShape& placed = s.find(point.instance, point.shape);
  Vec3f p, n;
  bool flip = false;
  if (placed.mesh) {
    const Impl::Triangle tri = s.triangle(placed, point.primitive, t);
    p = tri.p[0] * (1 - point.u - point.v) + tri.p[1] * point.u + tri.p[2] * point.v;
    if (ng) n = cross(tri.p[1] - tri.p[0], tri.p[2] - tri.p[0]);
    flip = placed.mesh->flip_normals != s.mirrored(placed, t);
  } else {
    const analytic::UnitPoint<float> unit = analytic::evaluate(placed.analytic.kind, point.u, point.v);
    p = placed.analytic.object_from_unit.point(unit.p);
    n = placed.unit_from_object.transposed_vector(unit.n);
    flip = placed.analytic.flip_normals;
  }
  if (placed.placement == Placement::kInstanced) {
    const Affine3f m = s.world(point.instance, t);
    p = m.point(p);
    if (ng) n = transform_normal(m, n);
  }
  if (ng) *ng = normalize(flip ? -n : n);
  return p;
}

float RayScene::triangle_area(std::uint32_t instance, std::uint32_t shape, std::uint32_t primitive, double t) const {
  const Impl& s = *impl_;
  const PlacedShape& placed = s.find(instance, shape);
  const Impl::Triangle tri = s.triangle(placed, primitive, t);
  Vec3f e1 = tri.p[1] - tri.p[0], e2 = tri.p[2] - tri.p[0];
  if (placed.placement == Placement::kInstanced) {
    const Affine3f m = s.world(instance, t);
    e1 = m.vector(e1), e2 = m.vector(e2);
  }
  return 0.5f * length(cross(e1, e2));
}

Affine3f RayScene::world_from_unit(std::uint32_t instance, std::uint32_t shape, double t) const {
  const PlacedShape& placed = impl_->find(instance, shape);
  const Affine3f& m = placed.analytic.object_from_unit;
  if (placed.placement != Placement::kInstanced) return m;
  const Affine3f world = impl_->world(instance, t) * m;
  return placed.moving.world ? Affine3f(make_invertible(Affine3d(world))) : world;
}

}  // namespace tempera
