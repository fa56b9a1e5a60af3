// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/memory.h"

#include <fmt/format.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>

namespace tempera {

namespace {

constexpr double kGiB = 1024.0 * 1024 * 1024;

// Measured with Embree 3.13.5 on meshes of 1 to 10 million triangles: bytes per triangle at the peak of a build, for
// resting triangles (high quality, with spatial splits) and for each pair of time steps of moving ones.
constexpr double kStaticTriangle = 340;
constexpr double kMovingTriangle = 300;

/// What the program takes by itself: threads, and what Embree sets up (measured: a scene of 12 triangles needs a limit of
/// 270 MiB with one thread, 330 with 16). Below it libraries fail in ways of their own.
constexpr double kProgram = 340.0 * 1024 * 1024;

template <class T>
std::uint64_t bytes(const std::vector<T>& v) {
  return v.capacity() * sizeof(T);
}

std::uint64_t mesh_memory(const Mesh& m) {
  std::uint64_t n = bytes(m.positions) + bytes(m.normals) + bytes(m.uvs) + bytes(m.uvs1) + bytes(m.tangents) +
                    bytes(m.tangent_signs) + bytes(m.indices) + bytes(m.colors) + bytes(m.color_alphas) +
                    bytes(m.skin.indices) + bytes(m.skin.weights) + bytes(m.skin.joints);
  for (const MorphTarget& t : m.morph_targets) n += bytes(t.positions) + bytes(t.normals) + bytes(t.tangents);
  n += bytes(m.source_vertices) + bytes(m.cache.vertices) + bytes(m.cache.fan_of) + bytes(m.cache.fan_begin) +
       bytes(m.cache.fans);  // the cache itself is mapped
  return n;
}

struct Parts {
  double structures = 0, vertices = 0, frames = 0;
  double sum() const { return structures + vertices + frames; }
};

Parts estimate(const Shot& shot, const Scene& scene) {
  const RenderSettings& s = shot.settings;
  const TimeSpan exposure = s.clock.exposure(shot.frames.empty() ? s.clock.first : shot.frames[0]);
  const double step = s.clock.frame_duration() / shot.motion_segments;
  double knots = std::ceil(exposure.length() / step) + 2;
  if (s.asks_for_chain_motion()) knots += std::ceil(2 * s.clock.frame_duration() / step) + 2;  // the frames around
  std::vector<int> uses(scene.groups.size(), 0);
  for (const Instance& i : scene.instances) ++uses[i.group];
  Parts p;
  for (std::size_t g = 0; g < scene.groups.size(); ++g) {
    for (const int shape : scene.groups[g]) {
      const auto* mesh = std::get_if<Mesh>(&scene.shapes[shape].geometry);
      if (!mesh) continue;
      const double triangles = double(mesh->triangle_count()), vertices = double(mesh->positions.size());
      const double per_vertex = sizeof(Vec3f) * (mesh->normals.empty() ? 1 : 2);
      if (mesh->deforms()) {  // each instance has vertices of its own, at every knot
        p.structures += uses[g] * triangles * kMovingTriangle * std::max(1.0, knots - 1);
        p.vertices += uses[g] * vertices * per_vertex * knots;
      } else {
        p.structures += triangles * kStaticTriangle;
        p.vertices += vertices * per_vertex;
      }
    }
  }
  double channels = 0, work = 0;
  const auto method = find_method(shot.integrator).make(shot.params);
  for (const LayerDesc& d : method->outputs(s)) channels += d.channel_count();
  for (const LayerDesc& d : method->work_layers(s)) work += d.channel_count();
  const int some_frame = shot.frames.empty() ? shot.sequence.first : shot.frames[0];
  const FrameRange section = method->section(s, shot.sequence, some_frame);
  double kept = 0, splats = 0;
  for (const PassDesc& pass : method->passes(s, section)) {
    kept = std::max(kept, double(pass.memory));
    splats += double(pass.splats.size());
  }
  // One frame renders, one waits to be written, one is being written together with its encoded form.
  const double pixels = double(s.x1() - s.x0()) * double(s.y1() - s.y0());
  const double together = double(section.last - section.first) + 1;
  p.frames = (3.0 * channels + together * (channels + work)) * pixels * sizeof(float);
  p.frames += together * pixels * (kept + splats * 3 * sizeof(std::int64_t));
  return p;
}

/// First number in a file, if it has one.
std::optional<std::uint64_t> read_number(const char* path) {
  std::ifstream in(path);
  std::uint64_t v = 0;
  if (in >> v) return v;
  return std::nullopt;
}

}  // namespace

std::uint64_t parse_memory_size(std::string_view text) {
  const auto fail = [&] {
    return Error(ErrorCode::kUsage, {"<command line>"},
                 fmt::format("cannot read the size \"{}\"; write for example 8G or 512M", text));
  };
  double value = 0;
  const auto [end, ec] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (ec != std::errc() || !(value > 0)) throw fail();
  std::string_view unit(end, text.data() + text.size() - end);
  if (unit.ends_with('B')) unit.remove_suffix(1);
  if (unit.ends_with('i')) unit.remove_suffix(1);
  const std::string_view units = "KMGT";
  if (unit.size() > 1 || (unit.size() == 1 && units.find(unit[0]) == std::string_view::npos)) throw fail();
  if (unit.size() == 1) value *= std::pow(1024.0, double(units.find(unit[0]) + 1));
  if (!(value >= 1 && value < 1e18)) throw fail();
  return std::uint64_t(value);
}

std::uint64_t machine_memory() {
  std::uint64_t bytes = std::uint64_t(sysconf(_SC_PHYS_PAGES)) * std::uint64_t(sysconf(_SC_PAGESIZE));
  for (const char* path : {"/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"}) {
    if (const auto limit = read_number(path); limit && *limit > 0) bytes = std::min(bytes, *limit);
  }
  return bytes;
}

void limit_memory(std::uint64_t bytes) {
  // Not RLIMIT_AS: libraries map files and reserve address space that is never used, gigabytes of it.
  rlimit limit{};
  getrlimit(RLIMIT_DATA, &limit);
  limit.rlim_cur = limit.rlim_max == RLIM_INFINITY ? rlim_t(bytes) : std::min<rlim_t>(limit.rlim_max, bytes);
  if (setrlimit(RLIMIT_DATA, &limit) != 0) {
    throw Error(ErrorCode::kFailed, fmt::format("the system refuses the memory limit: {}", std::strerror(errno)));
  }
}

std::uint64_t scene_memory(const Scene& scene) {
  std::uint64_t n = 0;
  for (const Shape& s : scene.shapes) {
    if (const auto* mesh = std::get_if<Mesh>(&s.geometry)) n += mesh_memory(*mesh);
  }
  for (const Environment& e : scene.environments) n += bytes(e.image);
  return n + bytes(scene.nodes) + bytes(scene.shapes) + bytes(scene.instances) + bytes(scene.lights);
}

std::uint64_t estimate_render_memory(const Shot& shot, const Scene& scene) {
  return std::uint64_t(estimate(shot, scene).sum());
}

void check_memory(const Shot& shot, const Scene& scene, std::uint64_t limit) {
  const Parts p = estimate(shot, scene);
  const double held = double(scene_memory(scene)), need = kProgram + held + p.sum();
  const double allowed = double(limit > 0 ? limit : machine_memory());
  if (need <= allowed) return;
  throw Error(ErrorCode::kOutOfMemory,
              fmt::format("this needs about {:.1f} GiB ({:.1f} the program, {:.1f} scene, {:.1f} ray tracing "
                          "structures, {:.1f} moving vertices, "
                          "{:.1f} pictures), more than the {:.1f} GiB {}",
                          need / kGiB, kProgram / kGiB, held / kGiB, p.structures / kGiB, p.vertices / kGiB,
                          p.frames / kGiB, allowed / kGiB, limit > 0 ? "of --memory-limit" : "of this machine"));
}

}  // namespace tempera
