// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/cryptomatte.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <charconv>
#include <cstring>
#include <nlohmann/json.hpp>

namespace tempera {

std::uint32_t murmur_hash3_32(std::string_view bytes, std::uint32_t seed) {
  constexpr std::uint32_t c1 = 0xcc9e2d51u, c2 = 0x1b873593u;
  const auto scramble = [](std::uint32_t k) { return std::rotl(k * c1, 15) * c2; };
  std::uint32_t h = seed;
  std::size_t i = 0;
  for (; i + 4 <= bytes.size(); i += 4) {
    std::uint32_t k = 0;  // little endian, whatever the machine
    for (int b = 3; b >= 0; --b) k = k << 8 | static_cast<unsigned char>(bytes[i + b]);
    h = std::rotl(h ^ scramble(k), 13) * 5 + 0xe6546b64u;
  }
  std::uint32_t tail = 0;
  for (std::size_t b = bytes.size(); b > i; --b) tail = tail << 8 | static_cast<unsigned char>(bytes[b - 1]);
  if (i < bytes.size()) h ^= scramble(tail);
  h ^= std::uint32_t(bytes.size());
  h = (h ^ h >> 16) * 0x85ebca6bu;
  h = (h ^ h >> 13) * 0xc2b2ae35u;
  return h ^ h >> 16;
}

std::uint32_t cryptomatte_hash(std::string_view name) {
  std::uint32_t h = murmur_hash3_32(name);
  const std::uint32_t exponent = h >> 23 & 255;
  if (exponent == 0 || exponent == 255) h ^= 1u << 23;
  return h;
}

float cryptomatte_id(std::string_view name) { return std::bit_cast<float>(cryptomatte_hash(name)); }

std::string cryptomatte_key(std::string_view layer_name) {
  return fmt::format("{:08x}", cryptomatte_hash(layer_name)).substr(0, 7);
}

void CryptomatteBuffer::add(Pixel& pixel, float id, float weight) {
  pixel.total += weight;
  if (id == 0) return;
  for (Share& known : pixel.ids) {
    if (known.id == id) {
      known.weight += weight;
      return;
    }
  }
  pixel.ids.push_back({id, weight});
}

void CryptomatteBuffer::add(int x, int y, float id, float weight) { add(pixels_.at(x, y), id, weight); }

void CryptomatteBuffer::merge(const CryptomatteBuffer& other) {
  TEMPERA_ASSERT(other.width() == width() && other.height() == height());
  for (std::size_t i = 0; i < pixels_.size(); ++i) {
    float rest = other.pixels_[i].total;
    for (const auto& [id, weight] : other.pixels_[i].ids) {
      add(pixels_[i], id, weight);
      rest -= weight;
    }
    pixels_[i].total += rest;
  }
}

void CryptomatteBuffer::save(ByteWriter& out) const {
  for (const Pixel& p : pixels_) {
    out.value(p.total);
    out.values(p.ids);
  }
}

void CryptomatteBuffer::load(ByteReader& in) {
  for (Pixel& p : pixels_) {
    in.value(p.total);
    in.values(p.ids);
  }
}

void CryptomatteBuffer::write(Frame& frame, const std::vector<std::string>& names, const std::string& layer_name,
                              int depth) const {
  const int layer_count = (std::max(depth, 1) + 1) / 2;
  std::vector<Image> images(layer_count, Image(width(), height(), 4));
  std::vector<std::pair<float, float>> ranked;
  for (int y = 0; y < height(); ++y) {
    for (int x = 0; x < width(); ++x) {
      const Pixel& p = pixels_.at(x, y);
      if (!(p.total > 0)) continue;
      ranked.clear();
      for (const auto& [id, weight] : p.ids) {
        if (weight > 0) ranked.push_back({id, std::min(weight / p.total, 1.0f)});
      }
      std::sort(ranked.begin(), ranked.end(), [](const auto& a, const auto& b) {
        return a.second != b.second ? a.second > b.second
                                    : std::bit_cast<std::uint32_t>(a.first) < std::bit_cast<std::uint32_t>(b.first);
      });
      const int n = std::min(int(ranked.size()), std::max(depth, 1));
      for (int r = 0; r < n; ++r) {
        images[r / 2].at(x, y, r % 2 * 2) = ranked[r].first;
        images[r / 2].at(x, y, r % 2 * 2 + 1) = ranked[r].second;
      }
    }
  }
  for (int i = 0; i < layer_count; ++i) {
    LayerDesc desc = layers::crypto(i);
    desc.name = fmt::format("{}{:02d}", layer_name, i);
    frame.add(std::move(desc), std::move(images[i]));
  }
  nlohmann::json manifest = nlohmann::json::object();
  for (const std::string& name : names) manifest[name] = fmt::format("{:08x}", cryptomatte_hash(name));
  const std::string prefix = "cryptomatte/" + cryptomatte_key(layer_name) + "/";
  frame.metadata[prefix + "name"] = layer_name;
  frame.metadata[prefix + "hash"] = "MurmurHash3_32";
  frame.metadata[prefix + "conversion"] = "uint32_to_float32";
  // Names that are not UTF-8 must not stop a frame from being written.
  frame.metadata[prefix + "manifest"] = manifest.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

std::map<std::string, float> cryptomatte_manifest(const Metadata& metadata, const std::string& layer_name) {
  const auto it = metadata.find("cryptomatte/" + cryptomatte_key(layer_name) + "/manifest");
  const std::string* text = it == metadata.end() ? nullptr : std::get_if<std::string>(&it->second);
  if (!text) {
    throw Error(ErrorCode::kUnknownName, fmt::format("no manifest of a cryptomatte \"{}\"", layer_name));
  }
  const auto bad = [&](const std::string& what) {
    return Error(ErrorCode::kBadInput, fmt::format("manifest of cryptomatte \"{}\": {}", layer_name, what));
  };
  const nlohmann::json json = nlohmann::json::parse(*text, nullptr, /*allow_exceptions=*/false);
  if (!json.is_object()) throw bad("not a JSON object");
  std::map<std::string, float> ids;
  for (const auto& [name, value] : json.items()) {
    std::uint32_t bits = 0;
    const std::string hex = value.is_string() ? value.get<std::string>() : "";
    const auto [end, ec] = std::from_chars(hex.data(), hex.data() + hex.size(), bits, 16);
    if (hex.empty() || ec != std::errc() || end != hex.data() + hex.size()) {
      throw bad(fmt::format("the id of \"{}\" is not a hexadecimal number", name));
    }
    ids[name] = std::bit_cast<float>(bits);
  }
  return ids;
}

Image cryptomatte_matte(const Frame& frame, float id, const std::string& layer_name) {
  frame.layer(layer_name + "00");  // names what is there when it is missing
  Image matte(frame.width(), frame.height(), 1);
  for (int i = 0; i < 100; ++i) {
    const Layer* l = frame.find(fmt::format("{}{:02d}", layer_name, i));
    if (!l) break;
    for (int y = 0; y < frame.height(); ++y) {
      for (int x = 0; x < frame.width(); ++x) {
        const float* p = l->image.pixel(x, y);
        for (int c = 0; c + 1 < l->image.channels(); c += 2) {
          if (p[c] == id) matte.at(x, y) += p[c + 1];
        }
      }
    }
  }
  return matte;
}

void rename_cryptomatte(Metadata& metadata, const std::string& from, const std::string& to) {
  const std::string old_prefix = "cryptomatte/" + cryptomatte_key(from) + "/";
  const std::string new_prefix = "cryptomatte/" + cryptomatte_key(to) + "/";
  if (from == to || !metadata.contains(old_prefix + "name")) return;
  for (const char* field : {"name", "hash", "conversion", "manifest", "manif_file"}) {
    if (auto node = metadata.extract(old_prefix + field); !node.empty()) {
      node.key() = new_prefix + field;
      metadata.insert(std::move(node));
    }
  }
  metadata[new_prefix + "name"] = to;
}

}  // namespace tempera
