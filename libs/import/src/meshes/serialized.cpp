// SPDX-License-Identifier: Apache-2.0
// Mitsuba's serialized meshes: one deflate stream after another, each behind a magic number and a version, and a table
// of their offsets at the end of the file. All numbers are little endian.
#include <fmt/format.h>
#include <zlib.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include "tempera/import/mesh_files.h"

namespace tempera {
namespace {

constexpr std::uint16_t kMagic = 0x041c;
enum Flags : std::uint32_t {
  kNormals = 0x0001,
  kTexcoords = 0x0002,
  kColors = 0x0008,
  kFaceNormals = 0x0010,
  kSingle = 0x1000,
  kDouble = 0x2000,
};

template <class T>
T load(std::string_view bytes, std::size_t at) {
  T value;
  std::memcpy(&value, bytes.data() + at, sizeof(T));
  return value;
}

/// Unpacks a deflate stream piece by piece.
class Inflater {
 public:
  Inflater(std::string_view packed, const std::string& file, std::uint64_t max_bytes)
      : file_(file), budget_(max_bytes) {
    if (inflateInit(&stream_) != Z_OK) throw Error(ErrorCode::kFailed, {file}, "cannot start zlib");
    stream_.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(packed.data()));
    rest_ = packed.size();
  }
  ~Inflater() { inflateEnd(&stream_); }
  Inflater(const Inflater&) = delete;
  Inflater& operator=(const Inflater&) = delete;

  void read(void* target, std::size_t size) {
    auto* out = static_cast<Bytef*>(target);
    while (size > 0) {
      if (stream_.avail_in == 0) {
        stream_.avail_in = uInt(std::min<std::size_t>(rest_, 1u << 30));
        rest_ -= stream_.avail_in;
      }
      stream_.next_out = out;
      stream_.avail_out = uInt(std::min<std::size_t>(size, 1u << 30));
      const uInt asked = stream_.avail_out;
      const int state = inflate(&stream_, Z_NO_FLUSH);
      const std::size_t got = asked - stream_.avail_out;
      out += got;
      size -= got;
      if (size == 0) return;
      if (state != Z_OK || (got == 0 && stream_.avail_in == 0 && rest_ == 0))
        throw Error(ErrorCode::kBadInput, {file_},
                    state == Z_DATA_ERROR ? "the compressed mesh is damaged" : "the compressed mesh ends too early");
    }
  }
  template <class T>
  T value() {
    T v;
    read(&v, sizeof v);
    return v;
  }
  /// `count` numbers of single or double precision. The array grows as data arrive, so that a count in a damaged header
  /// takes no more memory than there are data.
  std::vector<float> floats(std::uint64_t count, bool wide) {
    constexpr std::uint64_t kPiece = 1 << 20;
    std::vector<float> result;
    std::vector<double> piece;
    for (std::uint64_t done = 0; done < count;) {
      const std::uint64_t n = std::min(count - done, std::max(kPiece, done));
      spend(n * sizeof(float));
      result.resize(done + n);
      if (wide) {
        piece.resize(n);
        read(piece.data(), n * sizeof(double));
        std::transform(piece.begin(), piece.end(), result.begin() + std::ptrdiff_t(done),
                       [](double v) { return float(v); });
      } else {
        read(result.data() + done, n * sizeof(float));
      }
      done += n;
    }
    return result;
  }
  std::vector<std::uint32_t> indices(std::uint64_t count) {
    constexpr std::uint64_t kPiece = 1 << 20;
    std::vector<std::uint32_t> result;
    for (std::uint64_t done = 0; done < count;) {
      const std::uint64_t n = std::min(count - done, std::max(kPiece, done));
      spend(n * sizeof(std::uint32_t));
      result.resize(done + n);
      read(result.data() + done, n * sizeof(std::uint32_t));
      done += n;
    }
    return result;
  }

 private:
  void spend(std::uint64_t bytes) {
    used_ += bytes;
    if (budget_ != 0 && used_ > budget_)
      throw Error(ErrorCode::kOutOfMemory, {file_},
                  fmt::format("the mesh takes more than the limit of {} bytes", budget_));
  }
  const std::string& file_;
  std::uint64_t budget_, used_ = 0;
  z_stream stream_{};
  std::size_t rest_ = 0;
};

template <class T>
std::vector<T> as(const std::vector<float>& numbers) {
  std::vector<T> result(numbers.size() * sizeof(float) / sizeof(T));
  if (!numbers.empty()) std::memcpy(static_cast<void*>(result.data()), numbers.data(), numbers.size() * sizeof(float));
  return result;
}

}  // namespace

Mesh read_serialized(std::string_view bytes, const std::string& file, int shape_index, std::uint64_t max_bytes) {
  const auto fail = [&](ErrorCode code, const std::string& message) -> void { throw Error(code, {file}, message); };
  const auto check_header = [&](std::uint64_t at) {
    if (at > bytes.size() || bytes.size() - at < 4 || load<std::uint16_t>(bytes, at) != kMagic)
      fail(ErrorCode::kBadInput, fmt::format("there is no serialized mesh at byte {}", at));
    const auto version = load<std::uint16_t>(bytes, at + 2);
    if (version != 3 && version != 4)
      fail(ErrorCode::kUnsupported,
           fmt::format("serialized meshes of version {} cannot be read; known: 3, 4", version));
    return version;
  };
  const auto version = check_header(0);
  std::uint64_t offset = 0;
  if (shape_index != 0) {
    const std::size_t entry = version == 4 ? 8 : 4;
    const std::uint32_t count = bytes.size() >= 8 ? load<std::uint32_t>(bytes, bytes.size() - 4) : 0;
    if ((bytes.size() - 4) / entry < count)
      fail(ErrorCode::kBadInput,
           fmt::format("the table at the end claims {} meshes, more than the file can hold", count));
    if (shape_index < 0 || std::uint32_t(shape_index) >= count)
      fail(ErrorCode::kOutOfRange,
           fmt::format("there is no mesh {}; the file has meshes 0 to {}", shape_index, std::int64_t(count) - 1));
    const std::size_t at = bytes.size() - 4 - entry * (count - shape_index);
    offset = version == 4 ? load<std::uint64_t>(bytes, at) : load<std::uint32_t>(bytes, at);
    check_header(offset);
  }

  Inflater in(bytes.substr(offset + 4), file, max_bytes);
  const auto flags = in.value<std::uint32_t>();
  if (version == 4)
    while (in.value<char>() != 0) {  // the name of the shape
    }
  const auto vertex_count = in.value<std::uint64_t>(), triangle_count = in.value<std::uint64_t>();
  if (vertex_count > 0xffffffffu || triangle_count > 0xffffffffu / 3)
    fail(ErrorCode::kBadInput,
         fmt::format("mesh {} claims {} vertices and {} triangles", shape_index, vertex_count, triangle_count));
  const bool wide = flags & kDouble;
  Mesh mesh;
  mesh.positions = as<Vec3f>(in.floats(vertex_count * 3, wide));
  if (flags & kNormals) mesh.normals = as<Vec3f>(in.floats(vertex_count * 3, wide));
  if (flags & kTexcoords) mesh.uvs = as<Vec2f>(in.floats(vertex_count * 2, wide));
  if (flags & kColors) mesh.colors = as<Rgb>(in.floats(vertex_count * 3, wide));
  mesh.indices = in.indices(triangle_count * 3);

  for (const std::uint32_t i : mesh.indices)
    if (i >= vertex_count)
      fail(ErrorCode::kBadInput,
           fmt::format("mesh {} refers to vertex {}, but has {} vertices", shape_index, i, vertex_count));
  for (const Vec3f& p : mesh.positions)
    if (!is_finite(p))
      fail(ErrorCode::kBadInput, fmt::format("mesh {} has a position that is not finite", shape_index));
  for (Vec3f& n : mesh.normals) n = is_finite(n) ? normalize(n) : Vec3f{};
  for (Vec2f& uv : mesh.uvs)
    if (!std::isfinite(uv.x) || !std::isfinite(uv.y)) uv = {};
  return mesh;
}

}  // namespace tempera
