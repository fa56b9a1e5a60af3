// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/metadata.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <numeric>
#include <sstream>

namespace tempera {
namespace {
std::optional<double> number(const MetaValue& v) {
  if (const int* i = std::get_if<int>(&v)) return double(*i);
  if (const double* d = std::get_if<double>(&v)) return *d;
  return std::nullopt;
}

/// Reads attributes of one prefix and notes whether all were there.
class Reader {
 public:
  explicit Reader(const Metadata& m) : metadata_(m) {}
  std::string text(const char* name) {
    const MetaValue* v = value(name);
    const std::string* s = v ? std::get_if<std::string>(v) : nullptr;
    complete_ = complete_ && s;
    return s ? *s : std::string();
  }
  double number(const char* name) {
    const MetaValue* v = value(name);
    const std::optional<double> n = v ? tempera::number(*v) : std::nullopt;
    complete_ = complete_ && n;
    return n.value_or(0);
  }
  int integer(const char* name) {
    const MetaValue* v = value(name);
    const int* n = v ? std::get_if<int>(v) : nullptr;
    complete_ = complete_ && n;
    return n ? *n : 0;
  }
  std::uint64_t integer64(const char* name) {
    const std::string s = text(name);
    std::uint64_t n = 0;
    const auto [end, ec] = std::from_chars(s.data(), s.data() + s.size(), n);
    complete_ = complete_ && ec == std::errc() && end == s.data() + s.size();
    return n;
  }
  bool complete() const { return complete_; }

 private:
  const MetaValue* value(const char* name) const {
    const auto it = metadata_.find(std::string("tempera/") + name);
    return it == metadata_.end() ? nullptr : &it->second;
  }
  const Metadata& metadata_;
  bool complete_ = true;
};
}  // namespace

void save_metadata(const Metadata& metadata, ByteWriter& out) {
  out.value(std::uint64_t(metadata.size()));
  for (const auto& [key, value] : metadata) {
    out.text(key);
    out.value(std::uint8_t(value.index()));
    if (const auto* text = std::get_if<std::string>(&value)) out.text(*text);
    if (const auto* number = std::get_if<int>(&value)) out.value(*number);
    if (const auto* number = std::get_if<double>(&value)) out.value(*number);
  }
}

void read_metadata(Metadata& metadata, ByteReader& in) {
  metadata.clear();
  for (auto n = in.value<std::uint64_t>(); n > 0; --n) {
    const std::string key = in.text();
    const auto kind = in.value<std::uint8_t>();
    MetaValue& value = metadata[key];
    if (kind == 0) value = in.text();
    if (kind == 1) value = in.value<int>();
    if (kind == 2) value = in.value<double>();
  }
}

std::string to_text(const MetaValue& value) {
  return std::visit([](const auto& v) { return fmt::format("{}", v); }, value);
}

FrameRate frame_rate(double fps) {
  const double ntsc = std::round(fps * 1.001);  // 24 for 24000/1001
  if (std::abs(fps - ntsc / 1.001) < 6e-4 && std::abs(fps - std::round(fps)) > 1e-6) return {int(ntsc) * 1000, 1001};
  const int thousandths = int(std::round(fps * 1000)), divisor = std::gcd(thousandths, 1000);
  return {thousandths / divisor, 1000 / divisor};
}

bool RenderInfo::same_render(const RenderInfo& other) const {
  RenderInfo o = other;
  o.command = command, o.scene = scene, o.render_seconds = render_seconds;
  return o == *this;
}

std::string stage_settings_key(std::string_view stage) { return fmt::format("tempera/{}", stage); }
std::string stage_command_key(std::string_view stage) { return fmt::format("tempera/{}_command", stage); }
std::string stage_engine_key(std::string_view stage) { return fmt::format("tempera/{}_engine", stage); }
std::string stage_fingerprint_key(std::string_view stage) { return fmt::format("tempera/{}_fingerprint", stage); }

bool is_fingerprint_key(std::string_view key) {
  return key == kFingerprintKey || (key.starts_with("tempera/") && key.ends_with("_fingerprint"));
}

namespace {
constexpr const char* kClassesKey = "tempera/classes";
}  // namespace

void set_classes(Metadata& metadata, std::span<const ClassInfo> classes) {
  std::string lines;
  for (const ClassInfo& c : classes) {
    std::string expression = c.expression;
    std::replace_if(
        expression.begin(), expression.end(), [](char x) { return x == '\t' || x == '\n'; }, ' ');
    lines += fmt::format("{}\t{}\t{}\n", c.name, expression, fmt::join(c.chains, " "));
  }
  if (!classes.empty()) metadata[kClassesKey] = lines;
}

std::vector<ClassInfo> classes(const Metadata& metadata) {
  std::vector<ClassInfo> out;
  const auto found = metadata.find(kClassesKey);
  if (found == metadata.end()) return out;
  std::istringstream lines(to_text(found->second));
  for (std::string line; std::getline(lines, line);) {
    std::istringstream fields(line);
    ClassInfo c;
    std::getline(fields, c.name, '\t'), std::getline(fields, c.expression, '\t');
    for (std::string chain; fields >> chain;) c.chains.push_back(chain);
    out.push_back(std::move(c));
  }
  return out;
}

void set_render_info(Metadata& m, const RenderInfo& info) {
  m["tempera/version"] = info.version;
  m["tempera/command"] = info.command;
  m["tempera/scene"] = info.scene;
  m["tempera/scene_hash"] = info.scene_hash;
  m["tempera/integrator"] = info.integrator;
  m["tempera/parameters"] = info.parameters;
  m["tempera/spp"] = info.spp;
  m["tempera/seed"] = std::to_string(info.seed);  // 64 bits do not fit an EXR int
  m["tempera/frame"] = info.frame;
  m["tempera/fps"] = info.fps;
  m["tempera/shutter_open"] = info.shutter_open;
  m["tempera/shutter_close"] = info.shutter_close;
  m["tempera/render_seconds"] = info.render_seconds;
  m["tempera/motion"] = kMotionConvention;
}

std::optional<RenderInfo> render_info(const Metadata& m) {
  Reader r(m);
  RenderInfo info;
  info.version = r.text("version");
  info.command = r.text("command");
  info.scene = r.text("scene");
  info.scene_hash = r.text("scene_hash");
  info.integrator = r.text("integrator");
  info.parameters = r.text("parameters");
  info.spp = r.integer("spp");
  info.seed = r.integer64("seed");
  info.frame = r.integer("frame");
  info.fps = r.number("fps");
  info.shutter_open = r.number("shutter_open");
  info.shutter_close = r.number("shutter_close");
  info.render_seconds = r.number("render_seconds");
  if (!r.complete()) return std::nullopt;
  return info;
}

}  // namespace tempera
