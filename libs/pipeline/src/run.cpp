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

/// "out/f.mp4" for "out/f.####.exr".
fs::path default_movie(const fs::path& pattern, const char* extension) {
  const std::string name = pattern.filename().string();
  std::string stem = has_frame_pattern(name) ? name.substr(0, find_frame_place(name).begin) : pattern.stem().string();
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
  const std::string name = fs::path(plan.render.output).filename().string();
  plan.output = shot.final_output.empty() ? (fs::path(plan.render.output).parent_path() / "final" / name).string()
                                          : settle_output(config, shot, "reconstruct.path", name);
  const auto [first, last] = std::minmax_element(shot.frames.begin(), shot.frames.end());
  plan.sequence = {std::min(*first, shot.sequence.first), std::max(*last, shot.sequence.last)};
  plan.render.frames = reconstruction_inputs(shot.frames, plan.sequence, shot.reconstruct, layers);
  if (plan.render.frames.size() > 1) plan.render.output = numbered_pattern(plan.render.output);
  const fs::path rendered = plan.render.output;
  if (fs::absolute(plan.output).lexically_normal() == fs::absolute(rendered).lexically_normal()) {
    throw Error(
        ErrorCode::kBadInput, config.loc("reconstruct.path"),
        fmt::format("the final frames {} would replace those that they are made of; name another place", plan.output));
  }
  if (plan.sequence != shot.sequence) {
    log_warning(
        fmt::format("the shot has frames {}-{}: as others were asked for, {}-{} are taken for the sequence, and "
                    "frames near its ends differ from those of the shot alone",
                    shot.sequence.first, shot.sequence.last, plan.sequence.first, plan.sequence.last));
  }
  for (const int f : plan.render.frames) {
    if (std::find(shot.frames.begin(), shot.frames.end(), f) == shot.frames.end()) plan.neighbors.push_back(f);
  }
  // The rendered files are read by the stage: under our names, and without loss. What was asked for holds for the
  // result.
  plan.render.write.names = AovNames::kTempera;
  if (plan.render.write.compression == Compression::kDwaa) plan.render.write.compression = Compression::kZip;
}

/// `layers`: of the frames that are the result.
void plan_movie(const ShotConfig& config, const Shot& shot, const std::vector<LayerDesc>& layers, RunPlan& plan) {
  if (shot.video_path.empty() && shot.frames.size() < 2) return;
  fs::path movie = shot.video_path;
  if (movie.empty()) movie = default_movie(plan.render.output, shot.video.codec == "ffv1" ? ".mkv" : ".mp4");
  plan.video_path = (shot.is_part && !shot.video_path_is_typed ? with_range(movie, shot.frames) : movie).string();
  try {
    check_video(plan.video_path, shot.video);
  } catch (const Error& e) {
    const SourceLoc loc = config.loc(config.find("video.path") ? "video.path" : "video.codec");
    throw Error(ErrorCode::kBadInput, loc, e.message());
  }
  std::vector<std::string> names;
  names.reserve(layers.size());
  for (const LayerDesc& d : layers) names.push_back(d.name);
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
  if (shot.output.empty()) {
    const std::string name = shot_name(shot.source);
    plan.render.output = (fs::path("out") / name / (name + ".####.exr")).string();
  }
  plan.output = plan.render.output;
  const std::vector<LayerDesc> layers = find_method(shot.integrator).make(shot.params)->outputs(shot.settings);
  plan.reconstructs = has_differences(layers);
  std::vector<LayerDesc> result = layers;
  if (plan.reconstructs) {
    plan_reconstruction(config, shot, layers, plan);
    std::erase_if(result, [](const LayerDesc& d) { return !survives_reconstruction(d.name); });
  }
  check_shot_encoding(config, result, shot.final_write);
  if (video) plan_movie(config, shot, result, plan);
  return plan;
}

std::string movie_identity(const FrameSequence& frames, const VideoOptions& options) {
  std::string text = fmt::format("{};{};{};{};{};{}\n", options.fps, options.codec, options.crf, options.layer,
                                 options.display.exposure, int(options.display.tone_map));
  for (const int f : frames.frames()) text += fmt::format("{} {}\n", f, content_identity(frames.path(f)));
  return "tempera " + hash_hex(text);
}

}  // namespace tempera
