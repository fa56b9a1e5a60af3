// SPDX-License-Identifier: Apache-2.0
#include "tempera/paths/pixel_filter.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <vector>

namespace tempera {
namespace {

struct FilterTraits {
  FilterKind kind;
  const char* name;
  float radius;
};
constexpr std::array<FilterTraits, 5> kFilters{{{FilterKind::kBox, "box", 0.5f},
                                                {FilterKind::kTent, "tent", 1.0f},
                                                {FilterKind::kGaussian, "gaussian", 2.0f},
                                                {FilterKind::kMitchell, "mitchell", 2.0f},
                                                {FilterKind::kBlackmanHarris, "blackman_harris", 1.5f}}};

/// Where Mitchell's filter with B = C = 1/3 turns negative, in units of its radius: its outer piece is
/// -7/18 (2x - 2)^2 (2x - 8/7).
constexpr float kMitchellZero = 4.0f / 7;

/// Profile of a filter at x in units of its radius; 0 outside [-1, 1].
double profile(FilterKind kind, double x) {
  x = std::abs(x);
  if (x > 1) return 0;
  switch (kind) {
    case FilterKind::kBox:
      return 1;
    case FilterKind::kTent:
      return 1 - x;
    case FilterKind::kGaussian: {
      // The radius is four standard deviations; the small value left there is taken off, so that the filter ends at 0.
      return std::max(0.0, std::exp(-8 * x * x) - std::exp(-8.0));
    }
    case FilterKind::kMitchell: {  // [Mitchell 1988, Eq. 8]
      constexpr double b = 1.0 / 3, c = 1.0 / 3;
      x *= 2;
      if (x < 1) return ((12 - 9 * b - 6 * c) * x * x * x + (-18 + 12 * b + 6 * c) * x * x + (6 - 2 * b)) / 6;
      return ((-b - 6 * c) * x * x * x + (6 * b + 30 * c) * x * x + (-12 * b - 48 * c) * x + (8 * b + 24 * c)) / 6;
    }
    case FilterKind::kBlackmanHarris: {  // [Harris 1978], the minimum four-term window
      const double v = kPiD * (x + 1);
      return 0.35875 - 0.48829 * std::cos(v) + 0.14128 * std::cos(2 * v) - 0.01168 * std::cos(3 * v);
    }
  }
  return 0;
}

}  // namespace

/// Distribution of |filter| over [-1, 1] (units of the radius) in bins of equal width and constant density.
struct PixelFilter::Table {
  // A multiple of 14, so that the zero crossings of Mitchell's filter are edges and no bin has both signs.
  static constexpr int kBins = 2016;
  std::array<float, kBins + 1> cdf{};
  std::array<std::uint16_t, kBins> first_bin{};  ///< the bin of cdf value i / kBins: where a search begins
  float scale = 1;                               ///< integral of |filter| over integral of the filter
  double integral = 1;                           ///< of the filter

  explicit Table(FilterKind kind) {
    std::vector<double> sum(kBins + 1);
    double total = 0;
    for (int i = 0; i < kBins; ++i) {  // Simpson's rule
      const double h = 2.0 / kBins, a = -1 + i * h;
      const double mass = (profile(kind, a) + 4 * profile(kind, a + h / 2) + profile(kind, a + h)) * h / 6;
      total += mass;
      sum[std::size_t(i) + 1] = sum[i] + std::abs(mass);
    }
    for (int i = 0; i <= kBins; ++i) cdf[i] = float(sum[i] / sum.back());
    for (int i = 0, bin = 0; i < kBins; ++i) {
      while (cdf[std::size_t(bin) + 1] <= float(i) * (0.999999f / kBins)) ++bin;  // rounding must not skip one
      first_bin[i] = std::uint16_t(bin);
    }
    scale = float(sum.back() / total);
    integral = total;
  }

  /// Inverse of the distribution at u in [0,1).
  float invert(float u) const {
    std::size_t bin = first_bin[int(u * kBins)];
    while (cdf[bin + 1] <= u) ++bin;  // cdf ends with 1 > u
    const float s = (u - cdf[bin]) / (cdf[bin + 1] - cdf[bin]);
    return std::min((float(bin) + s) * (2.0f / kBins) - 1, 1.0f);
  }
};

PixelFilter::PixelFilter(FilterKind kind, float radius) : kind_(kind), radius_(radius) {
  if (radius == 0) radius_ = kFilters[std::size_t(kind)].radius;
  if (!(radius_ >= 0.01f && radius_ <= 32)) {
    throw Error(ErrorCode::kOutOfRange,
                fmt::format("the filter radius {} is not in [0.01, 32] (or 0 for the usual one)", radius));
  }
  if (kind != FilterKind::kBox && kind != FilterKind::kTent) table_ = std::make_shared<const Table>(kind);
  const double integral = table_ ? table_->integral : kind == FilterKind::kBox ? 2 : 1;
  norm_ = float(1 / (integral * double(radius_)));
}

float PixelFilter::evaluate(float x) const { return float(profile(kind_, double(x) / radius_)); }

float PixelFilter::density(const Vec2f& offset) const {
  const auto along = [&](float x) { return x >= -radius_ && x < radius_ ? evaluate(x) * norm_ : 0.0f; };
  return along(offset.x) * along(offset.y);
}

float PixelFilter::sample_axis(float u) const {
  if (kind_ == FilterKind::kBox) return 2 * u - 1;
  if (kind_ == FilterKind::kTent) return u < 0.5f ? std::sqrt(2 * u) - 1 : 1 - std::sqrt(2 * (1 - u));
  return table_->invert(u);
}

PixelFilter::Sample PixelFilter::sample(const Vec2f& u) const {
  const Vec2f x{sample_axis(u.x), sample_axis(u.y)};
  Sample s{x * radius_, 1};
  if (kind_ == FilterKind::kMitchell) {  // the only one with negative lobes
    const bool negative = (std::abs(x.x) > kMitchellZero) != (std::abs(x.y) > kMitchellZero);
    s.weight = table_->scale * table_->scale * (negative ? -1.0f : 1.0f);
  }
  return s;
}

FilterKind parse_filter(const std::string& name, const SourceLoc& loc) {
  std::vector<std::string> known;
  for (const FilterTraits& f : kFilters) {
    if (name == f.name) return f.kind;
    known.emplace_back(f.name);
  }
  throw Error(ErrorCode::kUnknownName, loc,
              fmt::format("unknown pixel filter \"{}\"; known: {}", name, nearest_names(name, known)));
}

std::string filter_name(FilterKind kind) { return kFilters[std::size_t(kind)].name; }

}  // namespace tempera
