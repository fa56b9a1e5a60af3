// SPDX-License-Identifier: Apache-2.0
// Mutates what a Mitsuba serialized file holds after unpacking and packs it again: mutations of the compressed bytes
// end at their checksum.
#include <zlib.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

extern "C" std::size_t LLVMFuzzerMutate(std::uint8_t* data, std::size_t size, std::size_t max_size);

extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* data, std::size_t size, std::size_t max_size,
                                               unsigned seed) {
  constexpr std::size_t kMaxBody = 1 << 14;
  if (size < 20 || seed % 8 == 0) return LLVMFuzzerMutate(data, size, max_size);
  std::vector<std::uint8_t> body(kMaxBody + 256);
  z_stream unpack{};
  if (inflateInit(&unpack) != Z_OK) return size;
  unpack.next_in = data + 4, unpack.avail_in = uInt(size - 4);
  unpack.next_out = body.data(), unpack.avail_out = uInt(kMaxBody);
  inflate(&unpack, Z_FINISH);
  const std::size_t length = kMaxBody - unpack.avail_out;
  inflateEnd(&unpack);
  if (length == 0) return LLVMFuzzerMutate(data, size, max_size);
  const std::size_t mutated = LLVMFuzzerMutate(body.data(), length, body.size());

  // Header, packed mesh, a table with one entry, its count.
  std::vector<std::uint8_t> out(4 + compressBound(uLong(mutated)));
  std::memcpy(out.data(), data, 4);
  uLongf packed = uLongf(out.size() - 4);
  if (compress2(out.data() + 4, &packed, body.data(), uLong(mutated), 1) != Z_OK) return size;
  out.resize(4 + packed);
  std::uint16_t version;
  std::memcpy(&version, data + 2, 2);
  out.resize(out.size() + (version >= 4 ? 8 : 4));
  for (const std::uint8_t byte : {1, 0, 0, 0}) out.push_back(byte);
  if (out.size() > max_size) return LLVMFuzzerMutate(data, size, max_size);
  std::copy(out.begin(), out.end(), data);
  return out.size();
}
