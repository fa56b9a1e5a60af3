// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/run.h"

#include <fmt/format.h>

#include <algorithm>

#include "hash.h"
#include "tempera/frames/frame.h"
#include "tempera/stages/reconstruct.h"

namespace tempera {

namespace {

namespace fs = std::filesystem;

/// What the files of a shot are called that names none: "dance" for dance.toml, "demo" for demo/shot.toml.
std::string shot_name(const fs::path& source) {
  const std::string stem = source.stem().string(), folder = fs::absolute(source).parent_path().filename().string();
  const bool generic = stem == "shot" || stem.starts_with("shot_");
  return generic && !folder.empty() ? folder + stem.substr(4) : stem;
}

/// A pattern with a place for the frame number. `path` that is no file name is a folder for `name`.
std::string frame_pattern(const fs::path& path, const std::string& name) {
  if (has_frame_pattern(path.string())) return path.string();
  if (path.extension() != ".exr") return (path / name).string();
  return (path.parent_path() / (path.stem().string() + ".####" + path.extension().string())).string();
}

/// "out/f.mp4" for "out/f.####.exr".
fs::path movie_beside(const fs::path& pattern, const char* extension) {
  const std::string name = pattern.filename().string(), one = frame_path(name, 1), minus = frame_path(name, -1);
  // Before the number: there the names of frame 1 and -1 begin to differ.
  std::string stem(one.begin(), std::mismatch(one.begin(), one.end(), minus.begin(), minus.end()).first);
  while (!stem.empty() && std::string_view("._-").find(stem.back()) != std::string_view::npos) stem.pop_back();
  return pattern.parent_path() / ((stem.empty() ? "movie" : stem) + extension);
}

fs::path with_range(const fs::path& movie, const std::vector<int>& frames) {
  const auto [first, last] = std::minmax_element(frames.begin(), frames.end());
  return movie.parent_path() /
         fmt::format("{}.{}-{}{}", movie.stem().string(), *first, *last, movie.extension().string());
}

void plan_reconstruction(const ShotConfig& config, const Shot& shot, const std::vector<LayerDesc>& layers,
                         RunPlan& plan) {
  const fs::path rendered = plan.render.output;
  const std::string name = rendered.filename().string();
  plan.output = shot.final_output.empty() ? (rendered.parent_path() / "final" / name).string()
                                          : frame_pattern(shot.final_output, name);
  if (fs::absolute(plan.output).lexically_normal() == fs::absolute(rendered).lexically_normal()) {
    throw Error(
        ErrorCode::kBadInput, config.loc("reconstruct.path"),
        fmt::format("the final frames {} would replace those that they are made of; name another place", plan.output));
  }
  const auto [first, last] = std::minmax_element(shot.frames.begin(), shot.frames.end());
  plan.sequence = {std::min(*first, shot.sequence.first), std::max(*last, shot.sequence.last)};
  if (plan.sequence != shot.sequence) {
    log_warning(
        fmt::format("the shot has frames {}-{}: as others were asked for, {}-{} are taken for the sequence, and "
                    "frames near its ends differ from those of the shot alone",
                    shot.sequence.first, shot.sequence.last, plan.sequence.first, plan.sequence.last));
  }
  plan.render.frames = reconstruction_inputs(shot.frames, plan.sequence, shot.reconstruct, layers);
  for (const int f : plan.render.frames) {
    if (std::find(shot.frames.begin(), shot.frames.end(), f) == shot.frames.end()) plan.beside.push_back(f);
  }
  // The rendered files are read by the stage: under our names, and without loss. What was asked for holds for the
  // result.
  plan.render.write.names = AovNames::kTempera;
  if (plan.render.write.compression == Compression::kDwaa) plan.render.write.compression = Compression::kZip;
}

void plan_movie(const ShotConfig& config, const Shot& shot, const std::vector<LayerDesc>& layers, RunPlan& plan) {
  if (shot.video_path.empty() && shot.frames.size() < 2) return;
  fs::path movie = shot.video_path;
  if (movie.empty()) movie = movie_beside(plan.render.output, shot.video.codec == "ffv1" ? ".mkv" : ".mp4");
  plan.video_path = (shot.is_part && !shot.video_path_is_typed ? with_range(movie, shot.frames) : movie).string();
  try {
    check_video(plan.video_path, shot.video);
  } catch (const Error& e) {
    const SourceLoc loc = config.loc(config.find("video.path") ? "video.path" : "video.codec");
    throw Error(ErrorCode::kBadInput, loc, e.message());
  }
  std::vector<std::string> names;
  for (const LayerDesc& d : layers) {
    if (!plan.reconstructs || survives_reconstruction(d.name)) names.push_back(d.name);
  }
  if (std::find(names.begin(), names.end(), shot.video.layer) == names.end()) {
    throw Error(ErrorCode::kBadInput, config.loc("video.layer"),
                fmt::format("the frames will have no layer \"{}\" to show; they have {}", shot.video.layer,
                            nearest_names(shot.video.layer, names)));
  }
}

}  // namespace

RunPlan plan_run(const ShotConfig& config, const Shot& shot, bool video) {
  RunPlan plan;
  plan.render = shot;
  plan.frames = shot.frames;
  plan.sequence = shot.sequence;
  const std::string name = shot_name(shot.source);
  plan.render.output =
      frame_pattern(shot.output.empty() ? fs::path("out") / name : fs::path(shot.output), name + ".####.exr");
  plan.output = plan.render.output;
  const std::vector<LayerDesc> layers = find_integrator(shot.integrator).make(shot.params)->outputs(shot.settings);
  plan.reconstructs = has_differences(layers);
  if (plan.reconstructs) plan_reconstruction(config, shot, layers, plan);
  if (video) plan_movie(config, shot, layers, plan);
  return plan;
}

std::string movie_identity(const FrameSequence& frames, const VideoOptions& options) {
  std::string text = fmt::format("{};{};{};{};{};{}\n", options.fps, options.codec, options.crf, options.layer,
                                 options.display.exposure, int(options.display.tone_map));
  for (const int f : frames.frames()) text += fmt::format("{} {}\n", f, content_identity(frames.path(f)));
  return "tempera " + hash_hex(text);
}

}  // namespace tempera
