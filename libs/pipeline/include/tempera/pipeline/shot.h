// SPDX-License-Identifier: Apache-2.0
#pragma once
// A shot: a scene and everything that says how to render a sequence of it. Loaded from shot.toml or from a scene file
// alone; each value comes from the command line, else shot.toml, else the scene file, else the built-in default.
#include <filesystem>
#include <string>
#include <vector>

#include "tempera/core/log.h"
#include "tempera/frames/frame.h"
#include "tempera/frames/video.h"
#include "tempera/import/import.h"
#include "tempera/methods/method.h"
#include "tempera/pipeline/shot_config.h"
#include "tempera/scene/scene.h"
#include "tempera/stages/stage.h"

namespace tempera {

/// A stage that follows the render.
struct ShotStage {
  StageChoice choice;
  std::string path;  ///< of its frames, as it was given; empty: none is named
};

struct Shot {
  std::filesystem::path source;  ///< shot.toml, or the scene file
  std::filesystem::path scene_file;
  RenderSettings settings;
  std::string integrator = "path";
  Params params;            ///< of the integrator
  std::vector<int> frames;  ///< in rendering order, each once
  /// First and last frame of the whole sequence, of which `frames` may be a part: where shot.toml or the scene says
  /// what the frames are, the command line chooses among them. What is computed over several frames goes by this.
  FrameRange sequence;
  bool is_part = false;           ///< the sequence has frames that `frames` leaves out
  std::string output;             ///< see frame_path; empty: none is named
  WriteOptions write;             ///< of the files that are rendered
  std::string mask;               ///< see frame_path; of images that say which pixels are wanted; empty: all are
  int motion_segments = 4;        ///< of a frame between knots of the motion grid
  std::vector<ShotStage> stages;  ///< in their order; where the shot names none, those made for such frames
  std::vector<std::string> stage_layers;  ///< that are rendered because stages can use them, and are not of the result
  int guide_spp = 8;                      ///< samples per pixel of guides, which stages take (StagePort::guides)
  int halo = -1;                     ///< frames at most around those asked for that are made for stages; -1: any number
  WriteOptions final_write;          ///< of the frames that are the result
  std::string video_path;            ///< of the movie; empty: none is named
  bool video_path_is_typed = false;  ///< on the command line, so for just these frames
  VideoOptions video;
  std::string edits;  ///< canonical text of what was changed in the scene (environment, materials)
};

struct LoadedShot {
  Shot shot;
  Scene scene;
};

/// Reads the scene that `config` names, as it stands in its file.
/// Errors: those of import_scene; Error{kBadInput} if it names none.
Scene import_shot_scene(const ShotConfig& config, const ImportOptions& options, Warnings& warnings);
/// Settles every value, and replaces environment and materials of the scene where the shot says so.
/// Errors: Error{kUnknownName | kBadInput | kOutOfRange} at the value in shot.toml, or with the file "<command line>".
Shot settle_shot(const ShotConfig& config, Scene& scene);
/// Both, one after the other.
LoadedShot load_shot(const ShotConfig& config, const ImportOptions& options, Warnings& warnings);

/// `file` is shot.toml (any .toml) or a scene file: in the latter case the key `scene` is set to it.
/// Errors: as ShotConfig::read_file; Error{kUnsupported} for an extension that nothing reads.
ShotConfig read_shot_config(const std::filesystem::path& file);

/// What the files of a shot are called that names none: "dance" for dance.toml, "demo" for demo/shot.toml.
std::string shot_name(const std::filesystem::path& source);

/// Layers of the frames that an integrator renders. Errors: those of Integrator::outputs.
std::vector<LayerDesc> rendered_layers(const std::string& integrator, const Params& params,
                                       const RenderSettings& settings);
inline std::vector<LayerDesc> rendered_layers(const Shot& shot) {
  return rendered_layers(shot.integrator, shot.params, shot.settings);
}

/// As output_pattern, of the value of `key` (output.path or the path of a stage). A name without a place for the number
/// is one file where the shot has a single frame, or where the command line gives the name and one frame: parts of a
/// shot that names its files itself must not replace each other. Errors: Error{kUsage | kBadInput} where the key was
/// given.
std::string settle_output(const ShotConfig& config, const Shot& shot, const std::string& key, const std::string& name);

/// Checks before rendering that frames of these layers can be stored under `options`. Errors: those of check_encoding,
/// at output.compression.
void check_shot_encoding(const ShotConfig& config, const std::vector<LayerDesc>& layers, const WriteOptions& options);

/// 128 bits in hex over everything that affects the pixels of the file of `frame`: scene content and edits, settings,
/// integrator and parameters, encoding, program version. Not threads, paths or time.
std::string fingerprint(const Shot& shot, const Scene& scene, int frame);

}  // namespace tempera
