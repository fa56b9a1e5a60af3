// SPDX-License-Identifier: Apache-2.0
// The types of materials: a declaration and a line in the list for each.
#include "tempera/shading/material_catalog.h"

#include <charconv>
#include <cmath>

#include "tempera/core/color.h"

namespace tempera {

extern const MaterialEntry diffuse_material;
extern const MaterialEntry conductor_material;
extern const MaterialEntry dielectric_material;
extern const MaterialEntry plastic_material;
extern const MaterialEntry principled_material;
extern const MaterialEntry metallic_roughness_material;

std::span<const MaterialEntry* const> material_catalog() {
  static const MaterialEntry* const entries[] = {
      &diffuse_material, &conductor_material,  &dielectric_material,
      &plastic_material, &principled_material, &metallic_roughness_material,
  };
  return entries;
}

const MaterialEntry* find_material(std::string_view name) {
  for (const MaterialEntry* e : material_catalog()) {
    if (e->name == name) return e;
  }
  return nullptr;
}

namespace {

std::optional<Rgb> parse_hex(std::string_view digits) {
  if (digits.size() != 6) return std::nullopt;
  std::uint32_t bits = 0;
  const auto [end, ec] = std::from_chars(digits.data(), digits.data() + 6, bits, 16);
  if (ec != std::errc() || end != digits.data() + 6) return std::nullopt;
  const auto channel = [&](int shift) { return srgb_to_linear(float((bits >> shift) & 255u) / 255.0f); };
  return Rgb{channel(16), channel(8), channel(0)};
}

}  // namespace

std::optional<Rgb> parse_color(std::string_view text) {
  if (text.starts_with('#')) return parse_hex(text.substr(1));
  std::vector<float> numbers;
  const char* at = text.data();
  const char* const end = text.data() + text.size();
  for (;;) {
    while (at != end && *at == ' ') ++at;
    float v = 0;
    const auto [next, ec] = std::from_chars(at, end, v);
    if (ec != std::errc() || !std::isfinite(v)) return std::nullopt;
    numbers.push_back(v);
    at = next;
    while (at != end && *at == ' ') ++at;
    if (at == end) break;
    if (*at++ != ',') return std::nullopt;
  }
  if (numbers.size() == 1) return Rgb(numbers[0]);
  if (numbers.size() == 3) return Rgb{numbers[0], numbers[1], numbers[2]};
  return std::nullopt;
}

}  // namespace tempera
