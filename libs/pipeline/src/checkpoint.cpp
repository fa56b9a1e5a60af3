// SPDX-License-Identifier: Apache-2.0
#include "checkpoint.h"

#include <fmt/format.h>

#include <cerrno>
#include <cstring>
#include <fstream>

#include "hash.h"
#include "tempera/frames/files.h"

namespace tempera {

namespace {

constexpr std::string_view kMagic = "tempera checkpoint 2\n";

/// Appends to a file and hashes what passes.
class Writer {
 public:
  explicit Writer(const std::string& path) : out_(path, std::ios::binary) {}
  void bytes(const void* data, std::size_t n) {
    const std::string_view view(static_cast<const char*>(data), n);
    hash_ = hash_bytes(view, hash_);
    out_.write(view.data(), std::streamsize(n));
  }
  template <class T>
  void value(const T& v) {
    static_assert(std::is_trivially_copyable_v<T>);
    bytes(&v, sizeof v);
  }
  void text(const std::string& s) {
    value(std::uint64_t(s.size()));
    bytes(s.data(), s.size());
  }
  /// Errors: Error{kFailed}.
  void finish(const std::string& path) {
    const std::uint64_t hash = hash_;
    value(hash);
    out_.close();
    if (!out_) throw Error(ErrorCode::kFailed, fmt::format("cannot write {}: {}", path, std::strerror(errno)));
  }

 private:
  std::ofstream out_;
  std::uint64_t hash_ = 0;
};

class Reader {
 public:
  explicit Reader(const std::string& path) : in_(path, std::ios::binary) {}
  bool bytes(void* data, std::size_t n) {
    if (!in_.read(static_cast<char*>(data), std::streamsize(n))) return false;
    hash_ = hash_bytes({static_cast<const char*>(data), n}, hash_);
    return true;
  }
  template <class T>
  bool value(T& v) {
    return bytes(&v, sizeof v);
  }
  bool text(std::string& s) {
    std::uint64_t n = 0;
    if (!value(n) || n > (1u << 24)) return false;
    s.resize(n);
    return bytes(s.data(), n);
  }
  std::uint64_t hash() const { return hash_; }

 private:
  std::ifstream in_;
  std::uint64_t hash_ = 0;
};

/// What the pixels in the file are: layers in order with their channels, and the size.
std::string layout(const Frame& frame) {
  std::string s = fmt::format("{}x{}/{}", frame.width(), frame.height(), kTileSize);
  for (const Layer& l : frame.layers()) s += fmt::format(";{}:{}", l.desc.name, l.image.channels());
  return s;
}

/// Calls f(values, bytes) for each row of each layer of a tile; `F` is Frame or const Frame.
template <class F, class Visit>
void for_rows(F& frame, const Tile& tile, Visit&& visit) {
  for (const std::string& name : frame.layer_names()) {
    auto& image = frame.layer(name);
    for (int y = tile.y0; y < tile.y1; ++y) {
      visit(image.pixel(tile.x0, y), std::size_t(tile.x1 - tile.x0) * std::size_t(image.channels()) * sizeof(float));
    }
  }
}

}  // namespace

std::vector<Tile> make_tiles(int width, int height) {
  std::vector<Tile> tiles;
  for (int y = 0; y < height; y += kTileSize) {
    for (int x = 0; x < width; x += kTileSize) {
      tiles.push_back({x, y, std::min(x + kTileSize, width), std::min(y + kTileSize, height)});
    }
  }
  return tiles;
}

std::string checkpoint_path(const std::string& frame_file) { return frame_file + ".partial"; }

void save_checkpoint(const std::string& path, const std::string& fingerprint, const Frame& frame,
                     std::span<const Tile> tiles, const CheckpointState& state) {
  TemporaryFile file(path);
  Writer out(file.path());
  out.bytes(kMagic.data(), kMagic.size());
  out.text(fingerprint);
  out.text(layout(frame));
  out.value(state.seconds);
  const RenderTotals& t = state.totals;
  for (const std::uint64_t n : {t.samples, t.rays, t.shadow_rays, t.bad_samples, std::uint64_t(t.first_bad.size())}) {
    out.value(n);
  }
  for (const BadSample& b : t.first_bad) out.value(b);
  out.bytes(state.done.data(), state.done.size());
  for (std::size_t i = 0; i < tiles.size(); ++i) {
    if (state.done[i]) for_rows(frame, tiles[i], [&](const float* row, std::size_t n) { out.bytes(row, n); });
  }
  out.finish(path);
  file.commit();
}

std::optional<CheckpointState> load_checkpoint(const std::string& path, const std::string& fingerprint, Frame& frame,
                                               std::span<const Tile> tiles, std::string& why) {
  Reader in(path);
  std::string magic(kMagic.size(), ' '), text;
  why = "it is damaged";
  if (!in.bytes(magic.data(), magic.size()) || magic != kMagic || !in.text(text)) return std::nullopt;
  if (text != fingerprint) {
    why = "it was made with other settings, or of another scene";
    return std::nullopt;
  }
  if (!in.text(text) || text != layout(frame)) return std::nullopt;
  CheckpointState state;
  std::uint64_t bad = 0;
  RenderTotals& t = state.totals;
  if (!in.value(state.seconds) || !in.value(t.samples) || !in.value(t.rays) || !in.value(t.shadow_rays) ||
      !in.value(t.bad_samples) || !in.value(bad) || bad > 16) {
    return std::nullopt;
  }
  t.first_bad.resize(bad);
  for (BadSample& b : t.first_bad) {
    if (!in.value(b)) return std::nullopt;
  }
  state.done.resize(tiles.size());
  if (!in.bytes(state.done.data(), state.done.size())) return std::nullopt;
  // Into a copy first: a file that turns out to be damaged at its end must leave no trace.
  Frame copy = frame;
  bool whole = true;
  for (std::size_t i = 0; i < tiles.size(); ++i) {
    if (!state.done[i]) continue;
    for_rows(copy, tiles[i], [&](float* row, std::size_t n) { whole = whole && in.bytes(row, n); });
  }
  std::uint64_t stored = 0;
  const std::uint64_t hash = in.hash();
  if (!whole || !in.value(stored) || stored != hash) return std::nullopt;
  frame = std::move(copy);
  return state;
}

}  // namespace tempera
