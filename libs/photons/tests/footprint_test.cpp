// SPDX-License-Identifier: Apache-2.0
#include "tempera/photons/footprint.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace tempera {
namespace {

constexpr std::array kKernels{SpatialKernel::kUniform, SpatialKernel::kEpanechnikov, SpatialKernel::kBiweight,
                              SpatialKernel::kGaussian};

/// A footprint in the plane z = 0 with half axes of lengths a and b, the first at `angle` from x, moving along x.
Footprint make_footprint(float a, float b, float angle, float speed) {
  const Vec3f s{std::cos(angle), std::sin(angle), 0}, t{-s.y, s.x, 0};
  return {{}, {s * (2 * a), t * (2 * b)}, {speed, 0, 0}};
}

/// Integral over the plane of the light that one unit of flux gives.
double energy(const Footprint& f, const KernelSettings& k, float rate = 0) {
  const Bounds3f box = footprint_bounds(f, k, {0, 0, 1}, 0.01f);
  constexpr int kSteps = 500;
  const float dx = (box.hi.x - box.lo.x) / kSteps, dy = (box.hi.y - box.lo.y) / kSteps;
  double sum = 0;
  for (int i = 0; i < kSteps; ++i) {
    for (int j = 0; j < kSteps; ++j)
      sum += swept_density(f, k, {box.lo.x + (float(i) + 0.5f) * dx, box.lo.y + (float(j) + 0.5f) * dy, 0}, rate);
  }
  return sum * dx * dy;
}

TEST(Footprint, KernelsHoldTheirFlux) {
  for (const SpatialKernel kernel : kKernels) {
    double plane = 0, line = 0;
    constexpr int kSteps = 20000;
    for (int i = 0; i < kSteps; ++i) {
      const double r = (i + 0.5) * 1.3 / kSteps;
      plane += 2 * kPiD * r * spatial_kernel(kernel, float(r * r)) * 1.3 / kSteps;
      line += 2 * spatial_kernel(kernel, float(r * r)) * 1.3 / kSteps;
    }
    EXPECT_NEAR(plane, kPiD, 1e-3);
    double mean = 0;
    for (int i = 0; i < kSteps; ++i)
      mean += time_weight(TimeFilter::kDecay, kernel, (float(i) + 0.5f) / kSteps) / kSteps;
    EXPECT_NEAR(mean, 1, 1e-3);
  }
}

TEST(Footprint, SweptLightIsConserved) {
  std::mt19937 engine(3);
  const auto random = [&](float a, float b) { return std::uniform_real_distribution<float>(a, b)(engine); };
  for (int k = 0; k < 12; ++k) {
    const Footprint f = make_footprint(random(0.05f, 1), random(0.05f, 1), random(0, 3), k == 0 ? 0 : random(0, 10));
    for (const SpatialKernel kernel : kKernels) {
      for (const Sweep sweep : {Sweep::kLine, Sweep::kClamped}) {
        for (const TimeFilter filter : {TimeFilter::kBox, TimeFilter::kDecay}) {
          for (const auto& [begin, end] : {std::pair{-0.5, 0.0}, {-0.3, 0.3}}) {
            EXPECT_NEAR(energy(f, {kernel, sweep, filter, begin, end}), 1, 0.01)
                << int(kernel) << " " << int(sweep) << " " << int(filter);
          }
        }
      }
    }
  }
}

// What the paper's Equation 7 makes of kernels that are not uniform: energies of section 4.3 of long sweeps.
TEST(Footprint, PublishedSweepsAreRightForTheUniformKernelAlone) {
  const auto of = [](float a, float b, float angle, SpatialKernel kernel) {
    return energy(make_footprint(a, b, angle, 6), {kernel, Sweep::kPublished, TimeFilter::kBox, 0, 1});
  };
  EXPECT_NEAR(of(1, 1, 0, SpatialKernel::kUniform), 1, 0.01);
  EXPECT_NEAR(of(1, 1, 0, SpatialKernel::kEpanechnikov), 1.264, 0.01);
  EXPECT_NEAR(of(1, 1, 0, SpatialKernel::kBiweight), 1.476, 0.01);
  EXPECT_NEAR(of(4, 1, kPi / 4, SpatialKernel::kUniform), 1, 0.01);
  EXPECT_NEAR(of(4, 1, kPi / 4, SpatialKernel::kEpanechnikov), 1.189, 0.01);
}

// The line sweep is the mean of the moving kernel over time, by whatever rate its flux changes.
TEST(Footprint, LineIsTheMeanOverTheExposure) {
  for (const SpatialKernel kernel : kKernels) {
    const Footprint f = make_footprint(0.6f, 0.2f, 0.5f, 3);
    for (const float rate : {0.0f, 0.9f, -1.5f}) {
      for (const Vec3f& at : {Vec3f{0.3f, 0.1f, 0}, Vec3f{-0.5f, 0.2f, 0}, Vec3f{1.1f, -0.1f, 0}}) {
        const KernelSettings k{kernel, Sweep::kLine, TimeFilter::kBox, -0.4, 0.5};
        double sum = 0;
        constexpr int kSteps = 20000;
        for (int i = 0; i < kSteps; ++i)
          sum += instant_density(f, kernel, at, float(-0.4 + 0.9 * (i + 0.5) / kSteps), rate) / kSteps;
        // Where flux changes, the quadrature meets the cut of the Gaussian and the flux that ends at 0.
        const double tolerance = rate == 0 ? 2e-4 : 0.01;
        EXPECT_NEAR(swept_density(f, k, at, rate), sum, tolerance * (1 + sum)) << int(kernel) << " " << rate;
      }
    }
  }
}

TEST(Footprint, TwoColumnsGiveTheEllipseInTheirParallelogram) {
  const std::array<Vec3d, 2> columns{Vec3d{2, 0.4, 0}, Vec3d{-0.3, 1, 0}};
  const FootprintAxes axes = footprint_axes(columns, {0, 0, 1}, 1e-6, 1e6);
  const Footprint f({}, axes, {});
  EXPECT_NEAR(1 / f.inverse_area, kPiD / 4 * length(cross(columns[0], columns[1])), 1e-5);
  // The conjugate half axes lie on its rim.
  for (const Vec3d& c : columns) EXPECT_NEAR(length(f.to_filter(Vec3f(c * 0.5))), 1, 1e-5);
  EXPECT_NEAR(dot(axes.a, axes.b), 0, 1e-6);
}

TEST(Footprint, AxesAreLimited) {
  bool clamped = false;
  const std::array<Vec3d, 2> thin{Vec3d{2, 0, 0}, Vec3d{1, 0, 0}};
  const FootprintAxes axes = footprint_axes(thin, {0, 0, 1}, 0.01, 0.5, &clamped);
  EXPECT_TRUE(clamped);
  EXPECT_NEAR(length(axes.a), 1, 1e-6);
  EXPECT_NEAR(length(axes.b), 0.02, 1e-6);
  const std::array<Vec3d, 2> nothing{};
  const FootprintAxes dot_axes = footprint_axes(nothing, {0, 1, 0}, 0.01, 0.5, &clamped);
  EXPECT_NEAR(length(dot_axes.a), 0.02, 1e-6);
  EXPECT_NEAR(length(dot_axes.b), 0.02, 1e-6);
}

TEST(Footprint, BoundsHoldAllOfIt) {
  const Footprint f = make_footprint(0.7f, 0.1f, 0.4f, 2);
  for (const SpatialKernel kernel : kKernels) {
    const KernelSettings k{kernel, Sweep::kLine, TimeFilter::kBox, -0.5, 0.5};
    const Bounds3f box = footprint_bounds(f, k, {0, 0, 1}, 0);
    for (float x = -3; x < 3; x += 0.01f) {
      for (float y = -3; y < 3; y += 0.01f) {
        if (swept_density(f, k, {x, y, 0}, 0) == 0) continue;
        EXPECT_TRUE(x >= box.lo.x && x <= box.hi.x && y >= box.lo.y && y <= box.hi.y);
      }
    }
  }
}

}  // namespace
}  // namespace tempera
