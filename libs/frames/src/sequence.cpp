// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/sequence.h"

#include <OpenImageIO/imageio.h>
#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <filesystem>
#include <iterator>
#include <limits>
#include <map>
#include <optional>
#include <set>

#include "tempera/core/error.h"
#include "tempera/core/time.h"

namespace fs = std::filesystem;

namespace tempera {
namespace {

std::optional<int> parse_number(std::string_view text) {
  int n = 0;
  const auto [end, ec] = std::from_chars(text.data(), text.data() + text.size(), n);
  if (text.empty() || ec != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return n;
}

/// Position and length of the last run of digits before the extension of a file name, with its sign.
struct Digits {
  std::size_t begin = 0, length = 0;
};
std::optional<Digits> last_digits(const std::string& name) {
  const auto is_digit = [&](std::size_t i) { return name[i] >= '0' && name[i] <= '9'; };
  std::size_t end = name.rfind('.');
  if (end == std::string::npos || end == 0) end = name.size();
  while (end > 0 && !is_digit(end - 1)) --end;
  if (end == 0) return std::nullopt;
  std::size_t begin = end;
  while (begin > 0 && is_digit(begin - 1)) --begin;
  // "f.-001.exr" is frame -1, "f-001.exr" frame 1.
  if (begin > 1 && name[begin - 1] == '-' && (name[begin - 2] == '.' || name[begin - 2] == '_')) --begin;
  return Digits{begin, end - begin};
}

template <class F>
void for_each_entry(const fs::path& directory, F&& f) {
  std::error_code ec;
  for (fs::directory_iterator it(directory.empty() ? "." : directory, ec), end; !ec && it != end; it.increment(ec)) {
    f(it->path().filename().string());
  }
}

std::string in_directory(const fs::path& directory, const std::string& name) {
  return directory.empty() ? name : (directory / name).string();
}

/// "png" for "a.PNG"; empty without an extension.
std::string lower_extension(const fs::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return char(std::tolower(c)); });
  return extension.empty() ? "" : extension.substr(1);
}

/// Whether files with this extension are images or movies, of which we write neither as frames.
bool is_picture_extension(const std::string& extension) {
  static const std::set<std::string> known = [] {
    std::set<std::string> all{"avi",  "avif", "bmp", "dpx", "gif", "hdr", "heic", "heif", "jp2",
                              "jpeg", "jpg",  "jxl", "m4v", "mkv", "mov", "mp4",  "mpg",  "pfm",
                              "png",  "ppm",  "psd", "svg", "tga", "tif", "tiff", "webm", "webp"};
    // "openexr:exr,sxr;tiff:tif,..."
    std::string word;
    for (const char c : std::string(OIIO::get_string_attribute("extension_list")) + ";") {
      if (std::isalnum(static_cast<unsigned char>(c))) {
        word += c;
        continue;
      }
      if (c != ':') all.insert(word);
      word.clear();
    }
    all.erase("");
    all.erase("exr");
    return all;
  }();
  return known.contains(extension);
}

Error not_exr(const std::string& path, const std::string& instead) {
  return Error(ErrorCode::kUsage,
               fmt::format("frames are written as OpenEXR, so \"{}\" cannot name them; write {}", path, instead));
}
}  // namespace

bool has_extension(const std::string& path, std::string_view extension) {
  return !extension.empty() && lower_extension(path) == extension.substr(1);
}

std::string output_pattern(const std::string& path, const std::string& name, bool single) {
  std::error_code ignored;
  if (path.empty() || path.ends_with('/') || fs::is_directory(path, ignored)) return in_directory(path, name);
  const FramePlace place = find_frame_place(path);
  if (place.length > 0) {
    const std::size_t end = place.begin + place.length;
    const fs::path tail =
        fmt::format("f{}", path.substr(end));  // a name that begins with a dot would have no extension
    const std::string extension = lower_extension(tail);
    if (extension == "exr") return path;
    if (extension.empty()) return path + ".exr";
    const std::string stem = tail.stem().string();
    throw not_exr(path, path.substr(0, end) + stem.substr(1) + (has_extension(stem, ".exr") ? "" : ".exr"));
  }
  const std::string extension = lower_extension(path);
  if (extension == "exr") return single ? path : numbered_pattern(path);
  if (is_picture_extension(extension)) {
    const std::string instead = fs::path(path).replace_extension("exr").string();
    throw not_exr(path, single ? instead : numbered_pattern(instead));
  }
  return in_directory(path, name);
}

std::string describe_frames(std::span<const int> frames) {
  std::string out;
  for (std::size_t i = 0; i < frames.size();) {
    std::size_t last = i + 1;
    const int step = last < frames.size() ? frames[last] - frames[i] : 1;
    while (last < frames.size() && frames[last] - frames[last - 1] == step) ++last;
    if (!out.empty()) out += ',';
    if (last - i < 3 && step != 1) last = i + 1;
    out += last - i == 1 ? fmt::format("{}", frames[i])
           : step == 1   ? fmt::format("{}-{}", frames[i], frames[last - 1])
                         : fmt::format("{}-{}x{}", frames[i], frames[last - 1], step);
    i = last;
  }
  return fmt::format("{} ({} {})", out, frames.size(), frames.size() == 1 ? "frame" : "frames");
}

std::vector<int> existing_frames(const std::string& pattern) {
  if (!has_frame_pattern(pattern)) return {};
  // What stands around the number: paths of two frames differ first in the number's last digit, and those of 1 and -1
  // in its first place.
  const std::string one = frame_path(pattern, 1), two = frame_path(pattern, 2), minus = frame_path(pattern, -1);
  const std::size_t last = std::mismatch(one.begin(), one.end(), two.begin(), two.end()).first - one.begin();
  const std::size_t first = std::mismatch(one.begin(), one.end(), minus.begin(), minus.end()).first - one.begin();
  const fs::path directory = fs::path(one).parent_path();
  const std::size_t name_begin = one.size() - fs::path(one).filename().string().size();
  const std::string prefix = one.substr(name_begin, first - name_begin), suffix = one.substr(last + 1);
  std::vector<int> frames;
  for_each_entry(directory, [&](const std::string& name) {
    if (name.size() <= prefix.size() + suffix.size() || !name.starts_with(prefix) || !name.ends_with(suffix)) return;
    const auto n =
        parse_number(std::string_view(name).substr(prefix.size(), name.size() - prefix.size() - suffix.size()));
    if (n && fs::path(frame_path(pattern, *n)).filename() == name) frames.push_back(*n);
  });
  std::sort(frames.begin(), frames.end());
  return frames;
}

FrameSequence::FrameSequence(const std::string& pattern) : pattern_(pattern) {
  std::error_code ec;
  if (fs::is_directory(pattern, ec)) {
    std::map<std::string, std::vector<int>> found;  // by pattern
    std::vector<std::string> single;
    for_each_entry(pattern, [&](const std::string& name) {
      if (name.starts_with(".") || lower_extension(name) != "exr") return;
      const auto digits = last_digits(name);
      if (!digits) {
        single.push_back(name);
        return;
      }
      const auto n = parse_number(name.substr(digits->begin, digits->length));
      if (!n) return;
      std::string p = name;
      p.replace(digits->begin, digits->length, std::string(digits->length, '#'));
      found[in_directory(pattern, p)].push_back(*n);
    });
    // "f.##.exr" also names f.100.exr: patterns that another one covers go.
    for (auto it = found.begin(); it != found.end();) {
      bool covered = false;
      for (const auto& other : found) {
        if (other.first.size() >= it->first.size()) continue;
        covered = covered || std::all_of(it->second.begin(), it->second.end(),
                                         [&](int n) { return frame_path(other.first, n) == frame_path(it->first, n); });
      }
      it = covered ? found.erase(it) : std::next(it);
    }
    if (found.empty() && single.size() == 1) {
      pattern_ = in_directory(pattern, single[0]);
      single_ = true;
      frames_ = {0};
      return;
    }
    if (found.empty()) throw Error(ErrorCode::kMissingFile, fmt::format("no EXR frames in directory {}", pattern));
    if (found.size() > 1) {
      std::string names;
      for (const auto& [p, frames] : found) names += (names.empty() ? "" : ", ") + p;
      throw Error(ErrorCode::kBadInput, fmt::format("{} holds several sequences; name one of {}", pattern, names));
    }
    pattern_ = found.begin()->first;
    frames_ = existing_frames(pattern_);
    return;
  }
  const bool is_file = fs::exists(pattern, ec);
  if (!has_frame_pattern(pattern) || (is_file && existing_frames(pattern).empty())) {
    if (is_file) {
      single_ = true;
      const std::string name = fs::path(pattern).filename().string();
      const auto digits = last_digits(name);
      frames_ = {digits ? parse_number(name.substr(digits->begin, digits->length)).value_or(0) : 0};
      return;
    }
    pattern_ = numbered_pattern(pattern);
    if (frames_ = existing_frames(pattern_); frames_.empty()) {
      throw Error(ErrorCode::kMissingFile, fmt::format("cannot open {}: no such file, directory or frames", pattern));
    }
    return;
  }
  frames_ = existing_frames(pattern);
  if (frames_.empty()) throw Error(ErrorCode::kMissingFile, fmt::format("no frames match {}", pattern));
}

FrameSequence::FrameSequence(const std::string& pattern, std::span<const int> frames) : pattern_(pattern) {
  single_ = !has_frame_pattern(pattern);
  std::error_code ignored;
  for (const int f : frames) {
    if (fs::exists(path(f), ignored)) frames_.push_back(f);
  }
  std::sort(frames_.begin(), frames_.end());
  if (frames_.empty()) throw Error(ErrorCode::kMissingFile, fmt::format("no frames match {}", pattern));
}

bool FrameSequence::has(int frame) const { return std::binary_search(frames_.begin(), frames_.end(), frame); }

void FrameSequence::keep(std::span<const int> frames) {
  std::vector<int> wanted(frames.begin(), frames.end()), both;
  std::sort(wanted.begin(), wanted.end());
  std::set_intersection(frames_.begin(), frames_.end(), wanted.begin(), wanted.end(), std::back_inserter(both));
  frames_ = std::move(both);
}

std::string FrameSequence::path(int frame) const { return single_ ? pattern_ : frame_path(pattern_, frame); }

int FrameSequence::step() const {
  long step = 0;
  for (std::size_t i = 1; i < frames_.size(); ++i) {
    const long d = long(frames_[i]) - frames_[i - 1];
    step = step == 0 ? d : std::min(step, d);
  }
  return int(std::clamp(step, 1L, long(std::numeric_limits<int>::max())));
}

}  // namespace tempera
