// SPDX-License-Identifier: Apache-2.0
#pragma once
// The gallery: the scenes on which the papers behind our methods were judged, rebuilt. A scene is made by code, as a
// folder that renders like any other: shot.toml, a scene file, textures, and a README that names the figure it stands
// for. Rendering is not done here.
#include <filesystem>
#include <map>
#include <span>
#include <string>
#include <utility>
#include <vector>

namespace tempera {

/// Another shot of the same scene: shot.toml with some keys changed, in shot_<name>.toml.
struct GalleryVariant {
  std::string name, help;
  std::vector<std::pair<std::string, std::string>>
      keys;  ///< dotted key of shot.toml, value as TOML writes it; empty: none
};

/// A light-path class that the scene is about.
struct GalleryClass {
  std::string name, expression, help;
};

/// A paper whose figures the gallery rebuilds.
struct GalleryPaper {
  std::string name;   ///< "Zimmer et al. 2015"
  std::string title;  ///< with where it appeared
};

class GalleryBuilder;

struct GalleryScene {
  std::string name;                     ///< as the command line has it, e.g. "glass-egg"
  std::string title;                    ///< one line
  const GalleryPaper* paper = nullptr;  ///< null: the scene is ours
  std::string figure;                   ///< of the paper, e.g. "Figure 14"
  std::uint64_t triangles = 0;          ///< placed by the scene's nodes
  int width = 640, height = 360;
  int first_frame = 1, last_frame = 24;
  double fps = 24;
  double shutter_open = 0, shutter_close = 0.5;
  int spp = 64;
  bool independent_samples = false;  ///< so that squared errors fall as 1 / samples
  int max_depth = 12;
  int reference_spp = 4096;  ///< samples per pixel of `tempera gallery reference`
  std::vector<GalleryClass> classes;
  bool decomposition = false;  ///< the classes are disjoint and add up to the picture with a residual
  bool camera_moves = false;
  std::vector<std::string> moving;  ///< objects in motion, by the names that cryptomatte has
  std::string needs;                ///< scene file of others, relative to GalleryOptions::scenes; empty: none
  std::vector<GalleryVariant> variants;
  std::string about;  ///< the README's text below its title, in Markdown
  void (*build)(GalleryBuilder&) = nullptr;

  std::string frames() const;      ///< "1-24"
  std::string stands_for() const;  ///< "Figure 14 of Zimmer et al. 2015"; empty without a paper
  const GalleryVariant* variant(const std::string& name) const;
};

/// All scenes, in alphabetical order.
std::span<const GalleryScene* const> gallery_catalog();
/// A scene by name, or by "name:variant". Errors: Error{kUnknownName} with the known ones.
struct GalleryChoice {
  const GalleryScene* scene;
  const GalleryVariant* variant;  ///< null: shot.toml itself
  std::string shot_file() const;  ///< "shot.toml" or "shot_<variant>.toml"
};
GalleryChoice find_gallery_scene(const std::string& text);

struct GalleryOptions {
  /// Folder with published scenes, for those of the gallery that are motions of one (see `needs`).
  std::filesystem::path scenes;
};

/// The files of a scene's folder by their names.
using GalleryFiles = std::map<std::string, std::string>;
/// Result: the same bytes for the same arguments. Errors: Error{kMissingFile} if what it `needs` is not there.
/// Threads: uses parallel loops.
GalleryFiles make_gallery_scene(const GalleryScene& scene, const GalleryOptions& options);
/// Writes those files that differ from what is on disk. Returns how many were written. Errors: as write_file.
int write_gallery_files(const GalleryFiles& files, const std::filesystem::path& folder);

/// The manual's page about the gallery, in Markdown.
std::string gallery_page();

}  // namespace tempera
