// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/compare.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "tempera/frames/frame.h"

namespace tempera {
namespace {

Image scaled(const Image& image, float scale) {
  Image out = image;
  for (float& v : out.values()) v *= scale;
  return out;
}

FrameFigures mean_of(const std::vector<FrameFigures>& frames) {
  FrameFigures mean;
  mean.frame = int(frames.size());
  if (frames.empty()) return mean;
  double flip = 0, hdr = 0;
  for (const FrameFigures& f : frames) {
    mean.mse += f.mse;
    mean.relative_mse += f.relative_mse;
    flip += f.flip;
    hdr += f.hdr_flip;
    mean.non_finite += f.non_finite;
  }
  const double n = double(frames.size());
  mean.mse /= n, mean.relative_mse /= n;
  // All frames have these figures or none.
  mean.flip = flip / n, mean.hdr_flip = hdr / n;
  return mean;
}

nlohmann::ordered_json json_of(const FrameFigures& f) {
  nlohmann::ordered_json j{{"mse", f.mse}, {"relative_mse", f.relative_mse}};
  if (f.flip >= 0) j["flip"] = f.flip;
  if (f.hdr_flip >= 0) j["hdr_flip"] = f.hdr_flip;
  j["non_finite"] = f.non_finite;
  return j;
}

/// A CSV field: quoted when it holds what separates fields.
std::string field(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos) return text;
  std::string out = "\"";
  for (const char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
  return out + "\"";
}

std::string csv_of(const FrameFigures& f) {
  const auto optional = [](double v) { return v >= 0 ? fmt::format("{}", v) : std::string(); };
  return fmt::format("{},{},{},{},{}\n", f.mse, f.relative_mse, optional(f.flip), optional(f.hdr_flip), f.non_finite);
}
}  // namespace

FrameFigures compare_images(const Image& test, const Image& reference, const CompareOptions& options) {
  FrameFigures f;
  f.mse = mse(test, reference);
  f.relative_mse = relative_mse(test, reference, nullptr, options.epsilon);
  f.non_finite = count_non_finite(test);
  if (options.flip) {
    const float scale = std::exp2(options.exposure);
    f.flip = scale == 1 ? flip(test, reference, nullptr, options.pixels_per_degree)
                        : flip(scaled(test, scale), scaled(reference, scale), nullptr, options.pixels_per_degree);
  }
  if (options.hdr_flip) f.hdr_flip = hdr_flip(test, reference, nullptr, options.pixels_per_degree);
  return f;
}

CompareResult compare_sequences(const std::vector<FrameSequence>& tests, const FrameSequence& reference,
                                const CompareOptions& options, const CompareProgress& progress) {
  CompareResult result{reference.pattern(), options.layer, {}};
  const bool still = reference.frames().size() == 1;
  const auto reference_frame = [&](int frame) { return still ? reference.frames()[0] : frame; };
  int total = 0, done = 0;
  std::vector<std::vector<int>> work;
  for (const FrameSequence& test : tests) {
    CompareSide side{test.pattern(), {}, {}, {}};
    std::vector<int> frames;
    for (const int f : test.frames()) {
      if (!options.frames.empty() && std::find(options.frames.begin(), options.frames.end(), f) == options.frames.end())
        continue;
      if (reference.has(reference_frame(f))) {
        frames.push_back(f);
      } else {
        side.unmatched.push_back(f);
      }
    }
    if (frames.empty()) {
      throw Error(ErrorCode::kBadInput,
                  fmt::format("{} and the reference {} have no frame to compare", test.pattern(), reference.pattern()));
    }
    total += int(frames.size());
    work.push_back(std::move(frames));
    result.sides.push_back(std::move(side));
  }

  ReadOptions read;
  read.layers = {options.layer};
  const auto load = [&](const std::string& path) {
    Frame f = read_frame(path, read);
    return std::move(f.layer(options.layer));
  };
  Image expected;
  std::string expected_path;
  for (std::size_t i = 0; i < tests.size(); ++i) {
    for (const int frame : work[i]) {
      const std::string test_path = tests[i].path(frame), path = reference.path(reference_frame(frame));
      if (path != expected_path) expected = load(path), expected_path = path;
      const Image image = load(test_path);
      if (image.width() != expected.width() || image.height() != expected.height()) {
        throw Error(ErrorCode::kBadInput,
                    fmt::format("{} has {}x{} pixels, the reference {} has {}x{}", test_path, image.width(),
                                image.height(), path, expected.width(), expected.height()));
      }
      FrameFigures f = compare_images(image, expected, options);
      f.frame = frame;
      result.sides[i].frames.push_back(f);
      if (progress) progress(++done, total);
    }
    result.sides[i].mean = mean_of(result.sides[i].frames);
  }
  return result;
}

std::string to_json(const CompareResult& result) {
  nlohmann::ordered_json j{
      {"layer", result.layer}, {"reference", result.reference}, {"sides", nlohmann::ordered_json::array()}};
  for (const CompareSide& s : result.sides) {
    nlohmann::ordered_json side{{"name", s.name},
                                {"mean", json_of(s.mean)},
                                {"frames", nlohmann::ordered_json::array()},
                                {"unmatched", s.unmatched}};
    for (const FrameFigures& f : s.frames) {
      nlohmann::ordered_json line{{"frame", f.frame}};
      line.update(json_of(f));
      side["frames"].push_back(std::move(line));
    }
    j["sides"].push_back(std::move(side));
  }
  return j.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
}

std::string to_csv(const CompareResult& result) {
  std::string text = "name,frame,mse,relative_mse,flip,hdr_flip,non_finite\n";
  for (const CompareSide& s : result.sides) {
    for (const FrameFigures& f : s.frames) text += fmt::format("{},{},{}", field(s.name), f.frame, csv_of(f));
    text += fmt::format("{},mean,{}", field(s.name), csv_of(s.mean));
  }
  return text;
}

std::string to_table(const CompareResult& result) {
  std::size_t width = 4;
  for (const CompareSide& s : result.sides) width = std::max(width, s.name.size());
  const bool several = result.sides.size() > 1;
  std::string text = fmt::format("{:{}}  {:>6}  {:>11}  {:>11}  {:>8}  {:>8}  {:>10}", "", width, "frames", "MSE",
                                 "relMSE", "FLIP", "HDR-FLIP", "non-finite");
  text += several ? "  relMSE to first\n" : "\n";
  const auto optional = [](double v) { return v >= 0 ? fmt::format("{:.5f}", v) : std::string("-"); };
  for (const CompareSide& s : result.sides) {
    const FrameFigures& m = s.mean;
    text += fmt::format("{:{}}  {:>6}  {:>11.5g}  {:>11.5g}  {:>8}  {:>8}  {:>10}", s.name, width, m.frame, m.mse,
                        m.relative_mse, optional(m.flip), optional(m.hdr_flip), m.non_finite);
    const double first = result.sides[0].mean.relative_mse;
    if (several) text += first > 0 ? fmt::format("  {:.3f}x", m.relative_mse / first) : "  -";
    text += "\n";
  }
  return text;
}

}  // namespace tempera
