// SPDX-License-Identifier: Apache-2.0
#include "tempera/scene/scene.h"

#include <fmt/format.h>

#include <algorithm>

#include "tempera/core/error.h"

namespace tempera {

Affine3d Scene::world(int node, double t, double piece) const {
  Affine3d m;
  for (; node >= 0; node = nodes[node].parent) m = nodes[node].local.at(t, piece) * m;
  return m;
}

void Scene::jumps(int node, TimeSpan span, std::vector<double>& out) const {
  for (; node >= 0; node = nodes[node].parent) {
    nodes[node].local.jumps(span, out);
    nodes[node].visibility.jumps(span, out);
  }
}

bool Scene::moves(int node, TimeSpan span) const {
  for (; node >= 0; node = nodes[node].parent) {
    if (nodes[node].local.varies_over(span)) return true;
  }
  return false;
}

bool Scene::visible(int node, double t) const {
  for (; node >= 0; node = nodes[node].parent) {
    if (nodes[node].visibility.at(t) < 0.5f) return false;
  }
  return true;
}

namespace {

class Validator {
 public:
  explicit Validator(const Scene& scene) : scene_(scene) {}

  void run() const {
    const int node_count = int(scene_.nodes.size());
    for (int i = 0; i < node_count; ++i) {
      const Node& n = scene_.nodes[i];
      require(n.parent < i && n.parent >= -1, "node", n.name, "has a parent that does not stand before it");
    }
    for (const Shape& s : scene_.shapes) check_shape(s);
    for (const auto& group : scene_.groups) {
      for (const int s : group)
        require(s >= 0 && s < std::ssize(scene_.shapes), "group", "", "refers to a missing shape");
    }
    for (const Instance& i : scene_.instances) {
      require(i.group >= 0 && i.group < std::ssize(scene_.groups), "instance", i.name, "refers to a missing group");
      check_node(i.node, "instance", i.name);
    }
    for (const PunctualLight& l : scene_.lights) check_node(l.node, "light", l.name);
    for (const Environment& e : scene_.environments) {
      check_node(e.node, "environment", e.name);
      require(std::ssize(e.image) == std::int64_t(e.width) * e.height, "environment", e.name,
              "has an image that does not fit its size");
      require(std::all_of(e.image.begin(), e.image.end(), [](const Rgb& c) { return is_finite(c); }), "environment",
              e.name, "has pixels that are not finite");
    }
    for (const Camera& c : scene_.cameras) {
      check_node(c.node, "camera", c.name);
      check_node(c.focus_node, "camera", c.name);
      require(c.pixel_aspect > 0 && std::isfinite(c.pixel_aspect), "camera", c.name, "has pixels of no width");
    }
  }

 private:
  void require(bool ok, const char* kind, const std::string& name, const char* what) const {
    if (ok) return;
    throw Error(ErrorCode::kBadInput, SourceLoc{scene_.source.string()},
                name.empty() ? fmt::format("a {} {}", kind, what) : fmt::format("{} \"{}\" {}", kind, name, what));
  }
  void check_node(int node, const char* kind, const std::string& name) const {
    require(node >= -1 && node < std::ssize(scene_.nodes), kind, name, "refers to a missing node");
  }

  void check_shape(const Shape& s) const {
    require(s.material != nullptr, "shape", s.name, "has no material");
    const auto* m = std::get_if<Mesh>(&s.geometry);
    if (!m) return;
    const std::size_t n = m->positions.size();
    const auto fits = [&](std::size_t size) { return size == 0 || size == n; };
    require(m->indices.size() % 3 == 0, "mesh", s.name, "has a number of indices that is not a multiple of 3");
    require(m->triangle_count() < (1u << 31), "mesh", s.name, "has more than 2^31 triangles");
    require(std::all_of(m->indices.begin(), m->indices.end(), [&](std::uint32_t i) { return i < n; }), "mesh", s.name,
            "has a vertex index out of range");
    require(std::all_of(m->positions.begin(), m->positions.end(), [](const Vec3f& p) { return is_finite(p); }), "mesh",
            s.name, "has positions that are not finite");
    require(fits(m->normals.size()) && fits(m->uvs.size()) && fits(m->uvs1.size()) && fits(m->tangents.size()) &&
                fits(m->tangent_signs.size()),
            "mesh", s.name, "has attributes whose count differs from its vertices");
    const std::size_t color_count = m->color_per_face ? m->triangle_count() : n;
    require(m->colors.empty() || m->colors.size() == color_count, "mesh", s.name, "has a wrong number of colors");
    require(m->color_alphas.empty() || m->color_alphas.size() == color_count, "mesh", s.name,
            "has a wrong number of color alphas");
    for (const MorphTarget& t : m->morph_targets) {
      require(fits(t.positions.size()) && fits(t.normals.size()) && fits(t.tangents.size()), "mesh", s.name,
              "has a morph target whose count differs from its vertices");
    }
    for (const auto& w : m->morph_weights.values()) {
      require(w.size() == m->morph_targets.size(), "mesh", s.name, "has morph weights that do not fit its targets");
    }
    require(m->morph_targets.empty() || !m->morph_weights.values().empty(), "mesh", s.name, "has no morph weights");
    const Skin& skin = m->skin;
    if (!skin.joints.empty()) {
      const std::size_t total = n * std::max(skin.influences, 0);
      require(skin.influences > 0 && skin.indices.size() == total && skin.weights.size() == total, "mesh", s.name,
              "has skin weights that do not fit its vertices");
      require(std::all_of(skin.indices.begin(), skin.indices.end(), [&](auto j) { return j < skin.joints.size(); }),
              "mesh", s.name, "has a joint index out of range");
      for (const auto& j : skin.joints) check_node(j.node, "mesh", s.name);
    }
    if (const VertexCache* cache = m->cache.samples.get()) {
      const std::vector<double>& times = cache->times();
      require(
          m->cache.vertices.empty() ? m->cache.first_vertex + n <= cache->vertices() : m->cache.vertices.size() == n,
          "mesh", s.name, "has a vertex cache of another number of vertices");
      require(std::all_of(m->cache.vertices.begin(), m->cache.vertices.end(),
                          [&](std::uint32_t v) { return v < cache->vertices(); }),
              "mesh", s.name, "has a vertex that is none of its vertex cache's");
      require(times.size() == cache->samples() && !times.empty() &&
                  std::adjacent_find(times.begin(), times.end(), [](double a, double b) { return !(a < b); }) ==
                      times.end(),
              "mesh", s.name, "has vertex cache times out of order");
    }
    require(fits(m->source_vertices.size()), "mesh", s.name, "has source vertices that do not fit its vertices");
  }

  const Scene& scene_;
};

}  // namespace

void validate(const Scene& scene) { Validator(scene).run(); }

}  // namespace tempera
