// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <algorithm>

#include "builder.h"
#include "tempera/core/error.h"
#include "tempera/frames/files.h"

namespace tempera {

// One scene is one file, scene_<name>.cpp, and one line here, in alphabetical order.
#define TEMPERA_GALLERY_SCENES(X) \
  X(ajar_door)                    \
  X(bathroom)                     \
  X(bookshelf)                    \
  X(coat_emit)                    \
  X(cornell_motion)               \
  X(glass_cylinder)               \
  X(glass_egg)                    \
  X(glossy_sphere)                \
  X(indoor)                       \
  X(loader)                       \
  X(modern_hall)                  \
  X(motion_tests)                 \
  X(moving_shadow)                \
  X(robot)                        \
  X(running_figure)               \
  X(sponza)                       \
  X(stadium)                      \
  X(vase)                         \
  X(wave)

#define TEMPERA_DECLARE(name) extern const GalleryScene name##_scene;
TEMPERA_GALLERY_SCENES(TEMPERA_DECLARE)
#undef TEMPERA_DECLARE

std::span<const GalleryScene* const> gallery_catalog() {
#define TEMPERA_ADDRESS(name) &name##_scene,
  static const std::vector<const GalleryScene*> scenes{TEMPERA_GALLERY_SCENES(TEMPERA_ADDRESS)};
#undef TEMPERA_ADDRESS
  return scenes;
}

std::string GalleryScene::frames() const { return fmt::format("{}-{}", first_frame, last_frame); }

std::string GalleryScene::stands_for() const { return paper ? fmt::format("{} of {}", figure, paper->name) : ""; }

const GalleryVariant* GalleryScene::variant(const std::string& wanted) const {
  const auto it =
      std::find_if(variants.begin(), variants.end(), [&](const GalleryVariant& v) { return v.name == wanted; });
  return it == variants.end() ? nullptr : &*it;
}

std::string GalleryChoice::shot_file() const { return variant ? "shot_" + variant->name + ".toml" : "shot.toml"; }

GalleryChoice find_gallery_scene(const std::string& text) {
  const auto colon = text.find(':');
  const std::string name = text.substr(0, colon);
  std::vector<std::string> names;
  for (const GalleryScene* s : gallery_catalog()) {
    names.push_back(s->name);
    if (s->name != name) continue;
    if (colon == std::string::npos) return {s, nullptr};
    const std::string wanted = text.substr(colon + 1);
    if (const GalleryVariant* v = s->variant(wanted)) return {s, v};
    std::vector<std::string> known;
    for (const GalleryVariant& v : s->variants) known.push_back(v.name);
    throw Error(ErrorCode::kUnknownName,
                fmt::format("the gallery's \"{}\" has no variant \"{}\"; {}", name, wanted,
                            known.empty() ? "it has none" : "known: " + nearest_names(wanted, known)));
  }
  throw Error(ErrorCode::kUnknownName, fmt::format("the gallery has no scene \"{}\"; known: {}", name,
                                                   nearest_names(name, names, names.size())));
}

GalleryFiles make_gallery_scene(const GalleryScene& scene, const GalleryOptions& options) {
  GalleryBuilder builder(scene, options);
  scene.build(builder);
  return builder.finish();
}

int write_gallery_files(const GalleryFiles& files, const std::filesystem::path& folder) {
  int written = 0;
  for (const auto& [name, bytes] : files) {
    const std::filesystem::path path = folder / name;
    std::error_code ignored;
    if (std::filesystem::is_regular_file(path, ignored) && read_file(path.string()) == bytes) continue;
    write_file(path.string(), bytes);
    ++written;
  }
  return written;
}

std::string gallery_page() {
  std::string out =
      "# The gallery\n\n"
      "The scenes on which the papers behind our methods were judged, rebuilt: geometry, textures and motion are made "
      "by "
      "`libs/gallery`. They are stand-ins, not copies: what a paper states is kept, the rest is ours. Two of them "
      "move the camera through published scenes, which have to be fetched by hand.\n\n"
      "```sh\ntempera gallery list\ntempera gallery run glass-egg --frames 12 --spp 256\n"
      "tempera gallery reference glass-egg      # converged frames; continues where it was stopped\n```\n\n"
      "| scene | stands for | triangles | frames | picture | needs |\n| --- | --- | --- | --- | --- | --- |\n";
  for (const GalleryScene* s : gallery_catalog()) {
    out += fmt::format("| [`{0}`](#{0}) | {1} | {2} | {3} | {4} x {5} | {6} |\n", s->name, s->stands_for(),
                       s->triangles, s->frames(), s->width, s->height, s->needs.empty() ? "" : "`" + s->needs + "`");
  }
  for (const GalleryScene* s : gallery_catalog()) {
    out += fmt::format("\n## {}\n\n{}.{}\n\n{}", s->name, s->title,
                       s->paper ? fmt::format(" {}: {}.", s->stands_for(), s->paper->title) : "", s->about);
    if (out.back() != '\n') out += '\n';
    for (const GalleryVariant& v : s->variants)
      out += fmt::format("{}- `{}:{}`: {}.\n", &v == &s->variants[0] ? "\n" : "", s->name, v.name, v.help);
  }
  return out;
}

}  // namespace tempera
