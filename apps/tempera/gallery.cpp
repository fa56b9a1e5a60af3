// SPDX-License-Identifier: Apache-2.0
#include "tempera/gallery/gallery.h"

#include <fmt/format.h>

#include <cstdio>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "program.h"
#include "tempera/core/log.h"

namespace tempera {

namespace {

constexpr const char* kRoot = "out/gallery";

/// Flags of the commands that make scenes.
struct GalleryFlags {
  std::string root = kRoot, scenes;

  void add_to(CLI::App& command) {
    command.add_option("--gallery", root, fmt::format("folder with a folder for each scene [{}]", kRoot))
        ->type_name("FOLDER");
    command
        .add_option("--scenes", scenes,
                    "folder with published scenes, for those of the gallery that move through one [the environment "
                    "variable TEMPERA_SCENES, else ../shared/scenes]")
        ->type_name("FOLDER");
  }
  GalleryOptions options() const {
    if (!scenes.empty()) return {scenes};
    const char* variable = std::getenv("TEMPERA_SCENES");
    return {variable && *variable ? variable : "../shared/scenes"};
  }
  std::filesystem::path folder(const GalleryScene& scene) const { return std::filesystem::path(root) / scene.name; }
};

/// As find_gallery_scene. Errors: Error{kUnknownName} at the command line.
GalleryChoice choose(const std::string& name) {
  try {
    return find_gallery_scene(name);
  } catch (const Error& e) {
    throw Error(e.code(), ShotConfig::kCommandLine(), e.message());
  }
}

void make(const GalleryScene& scene, const GalleryFlags& flags, const std::filesystem::path& folder) {
  const GalleryFiles files = make_gallery_scene(scene, flags.options());
  const int written = write_gallery_files(files, folder);
  if (written > 0) log_info(fmt::format("{}: {} of {} files written", folder.string(), written, files.size()));
}

void add_list_command(Program& program, CLI::App& gallery) {
  auto json = std::make_shared<bool>(false);
  CLI::App* command = program.add(
      gallery, "list", "Show the scenes: what they stand for, and their size.",
      {"tempera gallery list", "tempera gallery list --json"}, [json] {
        nlohmann::ordered_json list = nlohmann::ordered_json::array();
        if (!*json) std::printf("%-16s %-9s %-7s %-8s %s\n", "scene", "triangles", "frames", "picture", "stands for");
        for (const GalleryScene* s : gallery_catalog()) {
          std::vector<std::string> variants;
          for (const GalleryVariant& v : s->variants) variants.push_back(v.name);
          if (*json) {
            list.push_back({{"name", s->name},
                            {"title", s->title},
                            {"paper", s->paper ? s->paper->name : ""},
                            {"figure", s->figure},
                            {"triangles", s->triangles},
                            {"frames", s->frames()},
                            {"width", s->width},
                            {"height", s->height},
                            {"spp", s->spp},
                            {"reference_spp", s->reference_spp},
                            {"needs", s->needs},
                            {"variants", variants}});
            continue;
          }
          std::printf("%-16s %9llu %-7s %-8s %s\n", s->name.c_str(), static_cast<unsigned long long>(s->triangles),
                      s->frames().c_str(), fmt::format("{}x{}", s->width, s->height).c_str(), s->stands_for().c_str());
          if (!variants.empty())
            std::printf("%-16s variants: %s\n", "", fmt::format("{}", fmt::join(variants, ", ")).c_str());
          if (!s->needs.empty()) std::printf("%-16s needs %s\n", "", s->needs.c_str());
        }
        if (*json) std::printf("%s\n", list.dump(2).c_str());
        return 0;
      });
  command->add_flag("--json", *json, "as JSON");
}

void add_make_command(Program& program, CLI::App& gallery) {
  struct Flags {
    GalleryFlags gallery;
    std::vector<std::string> names;
    std::string out;
  };
  auto flags = std::make_shared<Flags>();
  CLI::App* command = program.add(
      gallery, "make", "Write the folders of scenes: shot.toml, scene, textures, README.",
      {"tempera gallery make glass-egg", "tempera gallery make vase -o vase", "tempera gallery make all"}, [flags] {
        std::vector<std::string> names = flags->names;
        if (!flags->out.empty() && (names.size() != 1 || names[0] == "all"))
          throw Error(ErrorCode::kUsage, ShotConfig::kCommandLine(), "-o names the folder of one scene");
        if (names.size() == 1 && names[0] == "all") {
          names.clear();
          for (const GalleryScene* s : gallery_catalog()) names.push_back(s->name);
        }
        for (const std::string& name : names) {
          const GalleryChoice choice = choose(name);
          const auto folder =
              flags->out.empty() ? flags->gallery.folder(*choice.scene) : std::filesystem::path(flags->out);
          make(*choice.scene, flags->gallery, folder);
          std::printf("%s\n", (folder / choice.shot_file()).string().c_str());
        }
        return 0;
      });
  command->add_option("name", flags->names, "scenes, or \"all\"")->required()->type_name("NAME");
  command->add_option("-o,--out", flags->out, fmt::format("the scene's folder [{}/NAME]", kRoot))->type_name("FOLDER");
  flags->gallery.add_to(*command);
}

struct RenderGalleryFlags {
  GalleryFlags gallery;
  RenderFlags render;
  std::string name;
};

/// Makes the scene and has its frames rendered to <scene>/<kind>/<scene>.####.exr, unless told otherwise.
void render_gallery_scene(Program& program, RenderGalleryFlags& flags, const GalleryChoice& choice, const char* kind) {
  const auto folder = flags.gallery.folder(*choice.scene);
  make(*choice.scene, flags.gallery, folder);
  const std::string stem = choice.scene->name + (choice.variant ? "_" + choice.variant->name : "");
  flags.render.shot.set_shot((folder / choice.shot_file()).string());
  flags.render.shot.preset("output.path", (folder / kind / (stem + ".####.exr")).string());
  const Shot shot = render_shot(program, flags.render).shot;
  if (!flags.render.replay.empty()) return;
  const ProgressKind progress = flags.render.progress_kind(program);
  if (progress != ProgressKind::kJson && progress != ProgressKind::kOpenJd) std::printf("%s\n", shot.output.c_str());
  hint_at_stages(shot);
}

void add_run_command(Program& program, CLI::App& gallery) {
  auto flags = std::make_shared<RenderGalleryFlags>();
  CLI::App* command =
      program.add(gallery, "run", "Make a scene and render it. Takes the flags of render.",
                  {"tempera gallery run glass-egg", "tempera gallery run running-figure:4x --frames 1-8 --spp 16",
                   "tempera gallery run robot --resolution 1280x720 --resume"},
                  [&program, flags] {
                    render_gallery_scene(program, *flags, choose(flags->name), "frames");
                    return 0;
                  });
  command->add_option("name", flags->name, "scene, or scene:variant")->required()->type_name("NAME");
  flags->gallery.add_to(*command);
  command->add_flag("--resume", flags->render.resume,
                    "skip frames that are finished, continue those that were interrupted");
  flags->render.add_overrides_to(*command);
}

void add_reference_command(Program& program, CLI::App& gallery) {
  auto flags = std::make_shared<RenderGalleryFlags>();
  CLI::App* command = program.add(
      gallery, "reference",
      "Render a scene until it has converged: the samples that its README names, with a seed of its own. What is "
      "finished is kept; the same command continues.",
      {"tempera gallery reference glass-egg", "tempera gallery reference stadium --spp 1024 --frames 1-5"},
      [&program, flags] {
        const GalleryChoice choice = choose(flags->name);
        ShotFlags& shot = flags->render.shot;
        shot.preset("sampling.spp", std::to_string(choice.scene->reference_spp));
        shot.preset("sampling.seed", "1000003");  // independent of what will be compared with it
        shot.preset("output.layers", "albedo,normal,motion,halves,color.var");
        flags->render.resume = true;
        render_gallery_scene(program, *flags, choice, "reference");
        return 0;
      });
  command->add_option("name", flags->name, "scene, or scene:variant")->required()->type_name("NAME");
  flags->gallery.add_to(*command);
  flags->render.add_overrides_to(*command);
}

}  // namespace

void add_gallery(Program& program) {
  CLI::App* gallery = program.app.add_subcommand("gallery", "The scenes of the papers: list, make, run, reference.");
  gallery->footer(
      "Examples:\n  tempera gallery list\n  tempera gallery run glass-egg --frames 12 --spp 256\n"
      "  tempera gallery reference glass-egg");
  gallery->require_subcommand(1);
  add_list_command(program, *gallery);
  add_make_command(program, *gallery);
  add_run_command(program, *gallery);
  add_reference_command(program, *gallery);
}

}  // namespace tempera
