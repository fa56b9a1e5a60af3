// SPDX-License-Identifier: Apache-2.0
// Mutates the chunks of a GLB file and writes lengths that fit them: plain mutations of the bytes rarely get past the
// container.
#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

extern "C" std::size_t LLVMFuzzerMutate(std::uint8_t* data, std::size_t size, std::size_t max_size);

namespace {

std::uint32_t word(const std::uint8_t* p) {
  std::uint32_t v;
  std::memcpy(&v, p, 4);
  return v;
}
void append(std::vector<std::uint8_t>& out, std::uint32_t v) {
  const auto* p = reinterpret_cast<const std::uint8_t*>(&v);
  out.insert(out.end(), p, p + 4);
}

}  // namespace

extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* data, std::size_t size, std::size_t max_size,
                                               unsigned seed) {
  struct Chunk {
    std::uint32_t type;
    std::vector<std::uint8_t> bytes;
  };
  std::vector<Chunk> chunks;
  for (std::size_t at = 12; at + 8 <= size;) {
    const std::size_t length = std::min<std::size_t>(word(data + at), size - at - 8);
    chunks.push_back({word(data + at + 4), {data + at + 8, data + at + 8 + length}});
    at += 8 + length;
  }
  if (chunks.empty() || seed % 16 == 0) return LLVMFuzzerMutate(data, size, max_size);
  // Two of three mutations go to the JSON chunk.
  Chunk& chosen = chunks[seed / 16 % 3 ? 0 : chunks.size() - 1];
  const std::size_t length = chosen.bytes.size();
  chosen.bytes.resize(std::max<std::size_t>(length + 256, 1));
  chosen.bytes.resize(LLVMFuzzerMutate(chosen.bytes.data(), length, chosen.bytes.size()));
  std::vector<std::uint8_t> out(data, data + std::min<std::size_t>(size, 8));
  append(out, 0);
  for (Chunk& c : chunks) {
    while (c.bytes.size() % 4) c.bytes.push_back(&c == chunks.data() ? ' ' : 0);
    append(out, std::uint32_t(c.bytes.size()));
    append(out, c.type);
    out.insert(out.end(), c.bytes.begin(), c.bytes.end());
  }
  if (out.size() > max_size) return LLVMFuzzerMutate(data, size, max_size);
  const std::uint32_t total = std::uint32_t(out.size());
  std::memcpy(out.data() + 8, &total, 4);
  std::copy(out.begin(), out.end(), data);
  return out.size();
}
