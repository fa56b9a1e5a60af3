// SPDX-License-Identifier: Apache-2.0
// Wavefront OBJ: the text is cut at line ends into blocks of a fixed size, which are parsed in parallel and joined in
// order, so that the result does not depend on the number of threads.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "input_files.h"
#include "tempera/core/parallel.h"
#include "tempera/import/mesh_files.h"
#include "triangulate.h"

namespace tempera {
namespace {

constexpr std::size_t kBlockBytes = 4 << 20;
constexpr std::uint32_t kNone = 0xffffffffu;
constexpr int kMaxChain = 64;  // longer chains make reading quadratic

/// Indices as in the file: from 1, 0 for absent.
struct Corner {
  std::int32_t position = 0, uv = 0, normal = 0;
};

struct Block {
  std::string_view text;
  std::vector<Vec3f> positions, normals;
  std::vector<Vec2f> uvs;
  std::vector<Corner> corners;
  std::vector<std::uint32_t> face_sizes;
  std::vector<std::size_t> relative;  // 3 * corner + component: counted back from what the file holds up to there
  std::optional<Error> error;
};

bool is_space(char c) { return c == ' ' || c == '\t' || c == '\r'; }

/// Whether the line that ends at `newline` (its '\n') goes on in the next one: it ends in a backslash. A comment never
/// does, so that one about a folder of Windows swallows nothing.
bool continues(const char* begin, const char* newline) {
  const char* p = newline;
  while (p > begin && is_space(p[-1])) --p;
  return p > begin && p[-1] == '\\' && !std::memchr(begin, '#', p - begin);
}

/// End of the statement that begins at `p`: its last line's '\n', or `end`.
const char* statement_end(const char* p, const char* end) {
  for (const char* line = p;;) {
    const void* found = std::memchr(line, '\n', end - line);
    if (!found) return end;
    const char* const newline = static_cast<const char*>(found);
    if (!continues(line, newline)) return newline;
    line = newline + 1;
  }
}

/// Whether `p` is the backslash that ends a line inside of a statement, or the last one of the file.
bool is_line_break(const char* p, const char* end) {
  if (*p != '\\') return false;
  for (++p; p < end && is_space(*p);) ++p;
  return p == end || *p == '\n';
}

bool is_blank(const char* p, const char* end) { return is_space(*p) || *p == '\n' || is_line_break(p, end); }

const char* skip_blanks(const char* p, const char* end) {
  while (p < end && is_blank(p, end)) ++p;
  return p;
}

/// Reads `count` numbers; nullptr if one is malformed.
const char* read_floats(const char* p, const char* end, float* values, int count) {
  for (int i = 0; i < count; ++i) {
    p = skip_blanks(p, end);
    if (p < end && *p == '+') ++p;
    const auto [next, failed] = std::from_chars(p, end, values[i]);
    if (failed == std::errc::result_out_of_range) {
      values[i] = std::strtof(std::string(p, next).c_str(), nullptr);  // 0 or infinity
    } else if (failed != std::errc()) {
      return nullptr;
    }
    p = next;
  }
  return p;
}

class BlockParser {
 public:
  BlockParser(Block& block, std::string_view whole, const std::string& file)
      : block_(block), whole_(whole), file_(file) {}

  void parse() {
    const char* p = block_.text.data();
    const char* const end = p + block_.text.size();
    while (p < end && !block_.error) {
      const char* const statement = statement_end(p, end);
      parse_statement(p, statement);
      p = statement + 1;
    }
  }

 private:
  void fail(const char* at, const std::string& message) {
    block_.error = Error(ErrorCode::kBadInput, locate(file_, whole_, at - whole_.data()), message);
  }
  static std::string excerpt(const char* begin, const char* end) {
    return std::string(begin, std::min<std::ptrdiff_t>(end - begin, 60));
  }

  void parse_statement(const char* begin, const char* end) {
    const char* p = skip_blanks(begin, end);
    const char* word_end = p;
    while (word_end<end&& * word_end> ' ' && !is_line_break(word_end, end)) ++word_end;
    const std::string_view word(p, word_end - p);
    float v[3];
    if (word == "v") {
      if (!read_floats(word_end, end, v, 3))
        return fail(p, fmt::format("cannot read three numbers in \"{}\"", excerpt(p, end)));
      block_.positions.push_back({v[0], v[1], v[2]});
      if (!is_finite(block_.positions.back())) fail(p, "a position must be finite");
    } else if (word == "vn") {
      if (!read_floats(word_end, end, v, 3))
        return fail(p, fmt::format("cannot read three numbers in \"{}\"", excerpt(p, end)));
      block_.normals.push_back({v[0], v[1], v[2]});
      if (!is_finite(block_.normals.back())) fail(p, "a normal must be finite");
    } else if (word == "vt") {
      const char* const next = read_floats(word_end, end, v, 1);
      if (!next) return fail(p, fmt::format("cannot read texture coordinates in \"{}\"", excerpt(p, end)));
      if (const char* const second = skip_blanks(next, end); second == end || *second == '#')
        v[1] = 0;  // the second one is optional
      else if (!read_floats(next, end, v + 1, 1))
        return fail(p, fmt::format("cannot read texture coordinates in \"{}\"", excerpt(p, end)));
      block_.uvs.push_back({v[0], v[1]});
      if (!std::isfinite(v[0]) || !std::isfinite(v[1])) fail(p, "texture coordinates must be finite");
    } else if (word == "f") {
      parse_face(word_end, end);
    }
  }

  void parse_face(const char* p, const char* end) {
    const std::size_t first = block_.corners.size();
    for (p = skip_blanks(p, end); p < end; p = skip_blanks(p, end)) {
      if (*p == '#') break;
      Corner corner;
      std::int32_t* const parts[3] = {&corner.position, &corner.uv, &corner.normal};
      const std::size_t counts[3] = {block_.positions.size(), block_.uvs.size(), block_.normals.size()};
      for (int i = 0; i < 3; ++i) {
        if (i > 0) {
          if (p == end || *p != '/') break;
          ++p;
          if (p == end || *p == '/' || is_blank(p, end)) continue;  // left out: "1//2"
        }
        const auto [next, failed] = std::from_chars(p, end, *parts[i]);
        if (failed != std::errc() || *parts[i] == 0)
          return fail(p, fmt::format("cannot read the vertex \"{}\" of a face; expected e.g. 12, 12/5, 12//7 or 12/5/7",
                                     excerpt(p, std::min(end, p + 20))));
        if (*parts[i] < 0) {
          *parts[i] += std::int32_t(counts[i]) + 1;
          block_.relative.push_back(3 * block_.corners.size() + i);
        }
        p = next;
      }
      if (p < end && *p != '#' && !is_blank(p, end))
        return fail(p, fmt::format("cannot read \"{}\" in a face; expected e.g. 12, 12/5, 12//7 or 12/5/7",
                                   excerpt(p, std::min(end, p + 20))));
      block_.corners.push_back(corner);
    }
    block_.face_sizes.push_back(std::uint32_t(block_.corners.size() - first));
  }

  Block& block_;
  std::string_view whole_;
  const std::string& file_;
};

std::vector<Block> cut(std::string_view text) {
  std::vector<Block> blocks;
  while (!text.empty()) {
    std::size_t size = std::min(kBlockBytes, text.size());
    const std::size_t line = text.rfind('\n', size - 1) + 1;  // 0 if there is none
    const char* const end = text.data() + text.size();
    size = std::min<std::size_t>(statement_end(text.data() + line, end) - text.data() + 1, text.size());
    blocks.emplace_back().text = text.substr(0, size);
    text.remove_prefix(size);
  }
  return blocks;
}

/// Place of face number `face` of `block`: found by reading again, since only errors ask for it.
SourceLoc face_location(const Block& block, std::size_t face, std::string_view whole, const std::string& file) {
  std::string_view rest = block.text;
  while (!rest.empty()) {
    const char* const end = statement_end(rest.data(), rest.data() + rest.size());
    const char* const p = skip_blanks(rest.data(), end);
    if (p < end && *p == 'f' && (p + 1 == end || is_blank(p + 1, end)) && face-- == 0)
      return locate(file, whole, p - whole.data());
    rest.remove_prefix(std::min<std::size_t>(end - rest.data() + 1, rest.size()));
  }
  return {file};
}

template <class T>
std::vector<T> join(std::vector<Block>& blocks, std::vector<T> Block::*part) {
  std::size_t size = 0;
  for (const Block& b : blocks) size += (b.*part).size();
  std::vector<T> all;
  all.reserve(size);
  for (Block& b : blocks) {
    all.insert(all.end(), (b.*part).begin(), (b.*part).end());
    b.*part = {};
  }
  return all;
}

}  // namespace

Mesh read_obj(std::string_view text, const std::string& file, Warnings& warnings) {
  text = skip_byte_order_mark(text);
  std::vector<Block> blocks = cut(text);
  parallel_for(0, std::int64_t(blocks.size()), [&](std::int64_t i) { BlockParser(blocks[i], text, file).parse(); });
  for (const Block& b : blocks)
    if (b.error) throw *b.error;

  // What is counted back counts from the end of all blocks before.
  std::size_t base[3] = {0, 0, 0}, corner_count = 0, triangle_count = 0;
  for (Block& b : blocks) {
    for (const std::size_t r : b.relative) {
      Corner& c = b.corners[r / 3];
      std::int32_t* const parts[3] = {&c.position, &c.uv, &c.normal};
      *parts[r % 3] = std::int32_t(std::int64_t(*parts[r % 3]) + std::int64_t(base[r % 3]));
      if (*parts[r % 3] <= 0) *parts[r % 3] = -1;  // before the first; 0 would mean absent
    }
    base[0] += b.positions.size();
    base[1] += b.uvs.size();
    base[2] += b.normals.size();
    corner_count += b.corners.size();
    for (const std::uint32_t n : b.face_sizes) triangle_count += n >= 3 ? n - 2 : 0;
  }
  if (std::max({base[0], base[1], base[2], corner_count}) >= 0x7fffffff)
    throw Error(ErrorCode::kBadInput, {file}, "more than 2^31 vertices or corners");

  const std::vector<Vec3f> positions = join(blocks, &Block::positions);
  const std::vector<Vec3f> normals = join(blocks, &Block::normals);
  const std::vector<Vec2f> uvs = join(blocks, &Block::uvs);

  // One vertex for each distinct triple: for each position, a chain of the vertices that use it.
  struct Vertex {
    std::int32_t uv, normal;
    std::uint32_t next;
  };
  std::vector<std::uint32_t> first(positions.size(), kNone);
  std::map<std::array<std::int32_t, 3>, std::uint32_t> crowded;  // beyond the first kMaxChain vertices of a position
  std::vector<Vertex> vertices;
  vertices.reserve(positions.size());
  Mesh mesh;
  mesh.positions.reserve(positions.size());
  mesh.indices.reserve(3 * triangle_count);
  bool has_uvs = false, has_normals = false;
  std::vector<std::uint32_t> polygon;
  PolygonMesher mesher(mesh);
  for (const Block& b : blocks) {
    std::size_t at = 0;
    for (std::size_t f = 0; f < b.face_sizes.size(); ++f) {
      const std::uint32_t n = b.face_sizes[f];
      polygon.clear();
      for (std::uint32_t i = 0; i < n; ++i) {
        const Corner& c = b.corners[at + i];
        const auto check = [&](std::int32_t index, std::int64_t size, const char* what) {
          if (index < 0 || index > size)
            throw Error(ErrorCode::kBadInput, face_location(b, f, text, file),
                        fmt::format("a face refers to {} {}, but the file has {}", what, index, size));
        };
        check(c.position, std::ssize(positions), "position");
        check(c.uv, std::ssize(uvs), "texture coordinate");
        check(c.normal, std::ssize(normals), "normal");
        has_uvs |= c.uv != 0;
        has_normals |= c.normal != 0;
        std::uint32_t* link = &first[c.position - 1];
        int steps = 0;
        while (*link != kNone && (vertices[*link].uv != c.uv || vertices[*link].normal != c.normal) &&
               steps++ < kMaxChain)
          link = &vertices[*link].next;
        if (steps > kMaxChain) link = &crowded.try_emplace({c.position, c.uv, c.normal}, kNone).first->second;
        const bool is_new = *link == kNone;
        const std::uint32_t vertex = is_new ? std::uint32_t(vertices.size()) : *link;
        if (is_new) {
          *link = vertex;  // before push_back, which may move what `link` points into
          vertices.push_back({c.uv, c.normal, kNone});
          mesh.positions.push_back(positions[c.position - 1]);
        }
        polygon.push_back(vertex);
      }
      at += n;
      if (!mesher.add(polygon)) warnings.add(kCrossedPolygon, face_location(b, f, text, file));
    }
  }
  if (has_uvs) {
    mesh.uvs.reserve(vertices.size());
    for (const Vertex& v : vertices) mesh.uvs.push_back(v.uv ? uvs[v.uv - 1] : Vec2f{});
  }
  if (has_normals) {
    mesh.normals.reserve(vertices.size());
    for (const Vertex& v : vertices) mesh.normals.push_back(v.normal ? normalize(normals[v.normal - 1]) : Vec3f{});
  }
  return mesh;
}

}  // namespace tempera
