// SPDX-License-Identifier: Apache-2.0
#pragma once
// Cryptomatte 1.2: anti-aliased selections by name, stored as ranked (id, coverage) pairs. Source: [Friedman 2015] and
// the specification of Psyop/Cryptomatte.
#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "tempera/core/bytes.h"
#include "tempera/core/grid.h"
#include "tempera/frames/frame.h"

namespace tempera {

/// MurmurHash3_x86_32 of bytes. Source: the algorithm of A. Appleby, public domain.
std::uint32_t murmur_hash3_32(std::string_view bytes, std::uint32_t seed = 0);

/// The id of a name (UTF-8): its hash, with the lowest exponent bit flipped where the bits would be a denormal, an
/// infinity or NaN as a float. Never 0 in practice (0 means "nothing").
std::uint32_t cryptomatte_hash(std::string_view name);
/// The id as the float that images store.
float cryptomatte_id(std::string_view name);

/// Name of a set of cryptomatte layers, e.g. "CryptoObject", and its key: the seven hexadecimal digits in
/// "cryptomatte/<key>/name".
std::string cryptomatte_key(std::string_view layer_name);

/// Ids and coverage of an image while it is rendered.
/// Threads: different pixels may be written concurrently.
class CryptomatteBuffer {
 public:
  CryptomatteBuffer() = default;
  CryptomatteBuffer(int width, int height) : pixels_(width, height) {}

  int width() const { return pixels_.width(); }
  int height() const { return pixels_.height(); }
  /// Adds a sample of filter weight `weight` that saw `id` (0: nothing) to a pixel.
  void add(int x, int y, float id, float weight = 1);
  /// Adds all samples of `other`, of the same size, in the rectangle [x0,x1) x [y0,y1) that both cover. The result is
  /// independent of the order only up to rounding: merge work units in their order.
  void merge(const CryptomatteBuffer& other);
  /// Adds the layers "<layer_name>00", ... for `depth` ranks (two a layer) and the header metadata with the manifest of
  /// `names`. Coverage is the share of the pixel's weight; ids whose weight is not positive are dropped; equal coverage
  /// is ordered by id.
  void write(Frame& frame, const std::vector<std::string>& names, const std::string& layer_name = "CryptoObject",
             int depth = 6) const;
  void save(ByteWriter& out) const;
  /// Pre: of a buffer of this size. Errors: Error{kBadInput}.
  void load(ByteReader& in);

 private:
  struct Share {
    float id, weight;
  };
  struct Pixel {
    float total = 0;
    std::vector<Share> ids;  ///< in the order of appearance
  };
  static void add(Pixel& pixel, float id, float weight);
  Grid<Pixel> pixels_;
};

/// Name -> id of a cryptomatte in a frame's metadata. Errors: Error{kUnknownName} if there is none of that name,
/// Error{kBadInput} for a manifest that is no JSON object of hexadecimal numbers.
std::map<std::string, float> cryptomatte_manifest(const Metadata& metadata,
                                                  const std::string& layer_name = "CryptoObject");
/// Coverage of `id` in every pixel: [h,w,1] in [0,1]. Errors: Error{kUnknownName} if the frame lacks the layers.
Image cryptomatte_matte(const Frame& frame, float id, const std::string& layer_name = "CryptoObject");

/// Renames a cryptomatte in the metadata (its key follows from the name). Nothing happens when `from` is not there.
void rename_cryptomatte(Metadata& metadata, const std::string& from, const std::string& to);

}  // namespace tempera
