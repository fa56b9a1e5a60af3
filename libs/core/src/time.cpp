// SPDX-License-Identifier: Apache-2.0
#include "tempera/core/time.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <unordered_set>

#include "tempera/core/error.h"

namespace tempera {

double Shutter::warp(double u) const {
  switch (shape) {
    case ShutterShape::kBox:
      return u;
    case ShutterShape::kTrapezoid: {  // area: ramps count half
      const double a = std::clamp(ramp_in, 0.0, 1.0), b = std::clamp(ramp_out, 0.0, 1.0 - a);
      const double total = 1 - 0.5 * (a + b), y = u * total;
      if (y < 0.5 * a) return std::sqrt(2 * a * y);
      if (y > total - 0.5 * b) return 1 - std::sqrt(std::max(0.0, 2 * b * (total - y)));
      return y + 0.5 * a;
    }
    case ShutterShape::kCurve: {
      if (curve.size() < 2) return u;
      double total = 0;
      for (std::size_t i = 0; i + 1 < curve.size(); ++i) total += 0.5 * (double(curve[i]) + curve[i + 1]);
      if (!(total > 0)) return u;
      double y = u * total;
      const double n = double(curve.size() - 1);
      for (std::size_t i = 0; i + 1 < curve.size(); ++i) {
        const double c0 = curve[i], c1 = curve[i + 1], area = 0.5 * (c0 + c1);
        if (y <= area && area > 0) {  // solve c0 s + (c1 - c0) s^2 / 2 = y
          const double root = c0 + std::sqrt(std::max(0.0, c0 * c0 + 2 * (c1 - c0) * y));
          const double s = root > 0 ? 2 * y / root : 0;
          return (double(i) + std::clamp(s, 0.0, 1.0)) / n;
        }
        y -= area;
      }
      return 1;
    }
  }
  return u;
}

double Shutter::density(double x) const {
  if (!(x >= 0 && x <= 1)) return 0;
  switch (shape) {
    case ShutterShape::kBox:
      return 1;
    case ShutterShape::kTrapezoid: {
      const double a = std::clamp(ramp_in, 0.0, 1.0), b = std::clamp(ramp_out, 0.0, 1.0 - a);
      const double height = 1 / (1 - 0.5 * (a + b));
      if (x < a) return height * x / a;
      return x > 1 - b ? height * (1 - x) / b : height;
    }
    case ShutterShape::kCurve: {
      if (curve.size() < 2) return 1;
      double total = 0;
      for (std::size_t i = 0; i + 1 < curve.size(); ++i) total += 0.5 * (double(curve[i]) + curve[i + 1]);
      if (!(total > 0)) return 1;
      const double n = double(curve.size() - 1);
      const std::size_t i = std::min(std::size_t(x * n), curve.size() - 2);
      const double s = x * n - double(i);
      return (curve[i] * (1 - s) + curve[i + 1] * s) * n / total;
    }
  }
  return 0;
}

TimeSpan FrameClock::exposure(int frame) const {
  const double rolling = std::abs(shutter.rolling);
  const double t = time(frame), d = frame_duration();
  return {t + shutter.open * d, t + (std::max(shutter.open, shutter.close) + rolling) * d};
}

double FrameClock::exposure_time(int frame, double u, double v) const {
  const double s = shutter.open + (shutter.close - shutter.open) * shutter.warp(u);
  const double delay = shutter.rolling >= 0 ? shutter.rolling * v : -shutter.rolling * (1 - v);
  return time(frame) + (s + delay) * frame_duration();
}

std::optional<FrameRange> FrameClock::frames_open_at(double t) const {
  // The exposures of all frames have one length; rounding may take or leave a frame at either end.
  const TimeSpan span = exposure(first);
  constexpr double kLast = std::numeric_limits<int>::max() - 1;
  const auto frame = [&](double offset) { return int(std::clamp(first + offset, -kLast, kLast)); };
  FrameRange r{frame(std::floor((t - span.end) * fps)), frame(std::ceil((t - span.begin) * fps))};
  while (r.first <= r.last && !exposure(r.first).contains(t)) ++r.first;
  while (r.first <= r.last && !exposure(r.last).contains(t)) --r.last;
  if (r.first > r.last) return std::nullopt;
  return r;
}

double FrameClock::exposure_density(int frame, double t, double v) const {
  const double length = shutter.close - shutter.open;
  const double delay = shutter.rolling >= 0 ? shutter.rolling * v : -shutter.rolling * (1 - v);
  const double x = ((t - time(frame)) * fps - delay - shutter.open) / length;
  const double rounding = 8 * std::numeric_limits<double>::epsilon() * (1 + std::abs(t) * fps) / length;
  if (!(x >= -rounding && x <= 1 + rounding)) return 0;
  return shutter.density(std::clamp(x, 0.0, 1.0)) * fps / length;
}

static int parse_int(std::string_view& s, std::string_view whole) {
  while (!s.empty() && s.front() == ' ') s.remove_prefix(1);
  if (!s.empty() && s.front() == '+') s.remove_prefix(1);
  int v = 0;
  const auto [end, ec] = std::from_chars(s.data(), s.data() + s.size(), v);
  if (ec != std::errc()) {
    throw Error(ErrorCode::kUsage,
                fmt::format("cannot read frames \"{}\"; write for example 1-24, 1..24, 1-100x2 or 1,5,10-20", whole));
  }
  s.remove_prefix(end - s.data());
  while (!s.empty() && s.front() == ' ') s.remove_prefix(1);
  return v;
}

std::vector<int> parse_frame_set(std::string_view text) {
  std::vector<int> frames;
  std::unordered_set<int> seen;
  std::string_view rest = text;
  constexpr long kMaxFrames = 10'000'000;
  for (;;) {
    const int first = parse_int(rest, text);
    int last = first, step = 1;
    if (rest.starts_with("..") || rest.starts_with("-")) {
      rest.remove_prefix(rest.front() == '.' ? 2 : 1);
      last = parse_int(rest, text);
      if (!rest.empty() && (rest.front() == 'x' || rest.front() == ':')) {
        rest.remove_prefix(1);
        step = parse_int(rest, text);
        if (step < 1)
          throw Error(ErrorCode::kUsage, fmt::format("frame step {} in \"{}\" must be at least 1", step, text));
      }
    }
    if (last < first) {
      throw Error(ErrorCode::kUsage, fmt::format("frame range {}-{} in \"{}\" runs backwards", first, last, text));
    }
    if ((long(last) - first) / step + long(frames.size()) >= kMaxFrames) {
      throw Error(ErrorCode::kUsage, fmt::format("\"{}\" names more than {} frames", text, kMaxFrames));
    }
    for (long f = first; f <= last; f += step) {
      if (const int frame = int(f); seen.insert(frame).second) frames.push_back(frame);
    }
    if (rest.empty()) return frames;
    if (rest.front() != ',') parse_int(rest = rest.substr(0, 0), text);  // reports the whole text
    rest.remove_prefix(1);
  }
}

namespace {
bool is_digit(char c) { return c >= '0' && c <= '9'; }

/// Length of the run of digits at `begin`.
std::size_t digits_at(std::string_view text, std::size_t begin) {
  std::size_t end = begin;
  while (end < text.size() && is_digit(text[end])) ++end;
  return end - begin;
}

/// The place for a number that begins at `i`; its length is 0 if none does.
FramePlace place_at(std::string_view name, std::size_t i) {
  constexpr std::size_t kMaxDigits = 2;  // of a width
  const auto place = [&](std::size_t length, std::string_view width) {
    int digits = 0;
    for (const char c : width) digits = digits * 10 + (c - '0');
    return FramePlace{i, length, digits};
  };
  const char c = name[i];
  if (c == '#' || c == '@') {
    const std::size_t length = std::min(name.find_first_not_of(c, i), name.size()) - i;
    const bool apart = (i == 0 || name[i - 1] == '.') && (i + 1 == name.size() || name[i + 1] == '.');
    return c == '@' && length == 1 && !apart ? FramePlace{}
                                             : FramePlace{i, length, int(std::min<std::size_t>(length, 20))};
  }
  if (c == '%') {
    const std::size_t digits = digits_at(name, i + 1);
    const std::size_t type = i + 1 + digits;
    if (digits <= kMaxDigits && type < name.size() && name[type] == 'd') {
      return place(digits + 2, name.substr(i + 1, digits));
    }
  }
  if (c == '$' && name.substr(i).starts_with("$F")) {
    const std::size_t digits = std::min<std::size_t>(digits_at(name, i + 2), 1);
    return place(2 + digits, name.substr(i + 2, digits));
  }
  if (c == '<') {
    for (const std::string_view word : {"<frame", "<F", "<f"}) {
      if (!name.substr(i).starts_with(word)) continue;
      const std::size_t digits = digits_at(name, i + word.size()), end = i + word.size() + digits;
      if (digits <= kMaxDigits && end < name.size() && name[end] == '>') {
        return place(end + 1 - i, name.substr(i + word.size(), digits));
      }
    }
  }
  return {};
}

/// Where the file name in a path begins.
std::size_t name_begin(std::string_view path) {
  const auto slash = path.rfind('/');
  return slash == std::string_view::npos ? 0 : slash + 1;
}
}  // namespace

FramePlace find_frame_place(std::string_view pattern) {
  for (std::size_t i = name_begin(pattern); i < pattern.size(); ++i) {
    if (const FramePlace place = place_at(pattern, i); place.length > 0) return place;
  }
  return {};
}

bool has_frame_pattern(std::string_view pattern) { return find_frame_place(pattern).length > 0; }

std::string frame_path(std::string_view pattern, int frame) {
  const FramePlace place = find_frame_place(pattern);
  if (place.length == 0) return std::string(pattern);
  const std::string sign = frame < 0 ? "-" : "";
  const std::string digits = fmt::format("{:0{}d}", std::abs(long(frame)), std::max(1, place.width - int(sign.size())));
  return std::string(pattern.substr(0, place.begin)) + sign + digits +
         std::string(pattern.substr(place.begin + place.length));
}

std::string numbered_pattern(std::string_view pattern) {
  if (has_frame_pattern(pattern)) return std::string(pattern);
  const std::size_t begin = name_begin(pattern);
  std::size_t dot = pattern.rfind('.');
  if (dot == std::string_view::npos || dot <= begin) dot = pattern.size();  // none, or that of a hidden file
  return std::string(pattern.substr(0, dot)) + ".####" + std::string(pattern.substr(dot));
}

}  // namespace tempera
