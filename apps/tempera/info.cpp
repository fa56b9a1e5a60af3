// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <cstdio>
#include <nlohmann/json.hpp>

#include "program.h"
#include "tempera/core/log.h"
#include "tempera/core/parallel.h"
#include "tempera/pipeline/caustics.h"
#include "tempera/pipeline/memory.h"
#include "tempera/pipeline/scene_info.h"

namespace tempera {

namespace {

std::string mib(std::uint64_t bytes) { return fmt::format("{:.1f} MiB", double(bytes) / (1 << 20)); }

std::string counted(std::size_t n, const char* one, const char* many) {
  return fmt::format("{} {}", n, n == 1 ? one : many);
}

void print_text(const SceneInfo& i, const Scene& scene) {
  const auto line = [](const char* name, const std::string& text) { std::printf("%-14s %s\n", name, text.c_str()); };
  line("scene", scene.source.string());
  for (const CameraInfo& c : i.cameras) {
    line("camera",
         fmt::format("\"{}\" {}{}{}", c.name,
                     c.orthographic ? "orthographic" : fmt::format("perspective, {:.2f} degrees wide", c.fov_degrees),
                     c.animated ? ", animated" : "", c.is_default ? " (default)" : ""));
  }
  if (i.cameras.empty()) line("camera", "none");
  for (const std::string& a : i.animations) line("animation", '"' + a + '"');
  line("time",
       i.animation.length() > 0 ? fmt::format("{:g} to {:g} s", i.animation.begin, i.animation.end) : "at rest");
  line("nodes", fmt::format("{}, of which {} move", i.nodes, i.moving_nodes));
  line("shapes",
       fmt::format("{}, {}, {}, {}", counted(i.meshes, "mesh", "meshes"), counted(i.spheres, "sphere", "spheres"),
                   counted(i.disks, "disk", "disks"), counted(i.cylinders, "cylinder", "cylinders")));
  line("deforming",
       fmt::format("{} with a skin, {} with morph targets, {} with a vertex cache", i.skinned, i.morphed, i.cached));
  line("instances", fmt::format("{}", i.instances));
  line("triangles", fmt::format("{} stored, {} placed", i.triangles, i.placed_triangles));
  line("materials", fmt::format("{}: {}", i.materials.size(), fmt::join(i.materials, ", ")));
  line("lights", fmt::format("{} area, {} point, {} spot, {} directional, {} projector", i.area_lights, i.point_lights,
                             i.spot_lights, i.directional_lights, i.projectors));
  line("environment", i.environments == 0 ? "none"
                      : i.environment_width == 0
                          ? counted(i.environments, "constant", "constant ones")
                          : fmt::format("{}, image {}x{}", i.environments, i.environment_width, i.environment_height));
  line("memory", mib(i.memory) + " of geometry and environment");
}

nlohmann::ordered_json to_json(const SceneInfo& i, const Scene& scene) {
  nlohmann::ordered_json cameras = nlohmann::ordered_json::array();
  for (const CameraInfo& c : i.cameras) {
    nlohmann::ordered_json j{{"name", c.name},
                             {"projection", c.orthographic ? "orthographic" : "perspective"},
                             {"animated", c.animated},
                             {"default", c.is_default}};
    if (!c.orthographic) j["fov_degrees"] = c.fov_degrees;
    cameras.push_back(std::move(j));
  }
  nlohmann::ordered_json j;
  j["scene"] = scene.source.string();
  j["content_hash"] = fmt::format("{:016x}", scene.content_hash);
  j["cameras"] = cameras;
  j["animations"] = i.animations;
  j["time"] = {{"begin", i.animation.begin}, {"end", i.animation.end}};
  j["nodes"] = i.nodes;
  j["moving_nodes"] = i.moving_nodes;
  j["shapes"] = {{"meshes", i.meshes}, {"spheres", i.spheres}, {"disks", i.disks}, {"cylinders", i.cylinders}};
  j["deforming"] = {{"skinned", i.skinned}, {"morphed", i.morphed}, {"cached", i.cached}};
  j["instances"] = i.instances;
  j["triangles"] = i.triangles;
  j["placed_triangles"] = i.placed_triangles;
  j["materials"] = i.materials;
  j["lights"] = {{"area", i.area_lights},     {"point", i.point_lights},
                 {"spot", i.spot_lights},     {"directional", i.directional_lights},
                 {"projector", i.projectors}, {"environment", i.environments}};
  j["memory"] = i.memory;
  return j;
}

int info(const ShotFlags& flags, bool json) {
  const ShotConfig config = flags.config();
  if (flags.memory_limit() > 0) limit_memory(flags.memory_limit());
  Warnings warnings;
  Scene scene = import_shot_scene(config, flags.import_options(), warnings);
  const std::vector<std::string> unsupported = warnings.lines();
  if (flags.strict()) warnings.report(true);
  const SceneInfo described = describe(scene);
  std::optional<Shot> shot;
  if (!scene.cameras.empty()) shot = settle_shot(config, scene);
  const std::uint64_t memory = shot ? estimate_render_memory(*shot, scene) : 0;
  const std::optional<PhotonSurvey> photons = shot ? survey_photons(scene, *shot) : std::nullopt;
  if (photons && photons->casters == 0) log_warning(kNoCasters);

  if (!json) {
    print_text(described, scene);
    if (shot) {
      const RenderSettings& s = shot->settings;
      std::printf("%-14s %s at %g per second\n", "frames", describe_frames(shot->frames).c_str(), s.clock.fps);
      std::printf("%-14s %dx%d, %d samples per pixel, %s(%s)\n", "picture", s.x1() - s.x0(), s.y1() - s.y0(), s.spp,
                  shot->integrator.c_str(), shot->params.canonical().c_str());
      std::printf("%-14s about %s on top of the scene\n", "rendering", mib(memory).c_str());
      if (photons) {
        std::printf("%-14s frame %d, towards %s: %s\n", "photons", shot->frames.front(),
                    counted(std::size_t(photons->casters), "caster", "casters").c_str(),
                    describe(photons->counts).c_str());
      }
    }
    for (const std::string& line : unsupported) std::printf("%-14s %s\n", "unsupported", line.c_str());
    return 0;
  }
  nlohmann::ordered_json j = to_json(described, scene);
  if (shot) {
    const RenderSettings& s = shot->settings;
    j["shot"] = {{"frames", shot->frames},
                 {"fps", s.clock.fps},
                 {"shutter", {s.clock.shutter.open, s.clock.shutter.close}},
                 {"width", s.width},
                 {"height", s.height},
                 {"spp", s.spp},
                 {"camera", scene.cameras[s.camera].name},
                 {"integrator", shot->integrator},
                 {"parameters", shot->params.canonical()},
                 {"layers", s.layers},
                 {"render_memory", memory}};
    if (photons) {
      const PhotonCounts& c = photons->counts;
      const double whole = std::max(c.emitted_flux, 1e-300);
      j["shot"]["photons"] = {{"frame", shot->frames.front()},
                              {"casters", photons->casters},
                              {"emitted", c.emitted},
                              {"stored", c.stored},
                              {"clamped", c.clamped},
                              {"stored_flux", c.stored_flux / whole},
                              {"escaped_flux", c.escaped_flux / whole},
                              {"absorbed_flux", c.absorbed_flux / whole}};
    }
  }
  j["unsupported"] = unsupported;
  std::printf("%s\n", j.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace).c_str());
  return 0;
}

}  // namespace

void add_info(Program& program) {
  struct Flags {
    ShotFlags shot;
    bool json = false;
  };
  auto flags = std::make_shared<Flags>();
  CLI::App* command =
      program.add("info", "Say what a scene or shot consists of, and what of it is not supported.",
                  {"tempera info scene.xml", "tempera info robot.glb --json"}, [flags] {
                    int status = 0;
                    with_threads(flags->shot.threads(), [&] { status = info(flags->shot, flags->json); });
                    return status;
                  });
  flags->shot.add_to(*command);
  command->add_flag("--json", flags->json, "as JSON");
}

}  // namespace tempera
