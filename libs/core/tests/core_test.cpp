// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include <atomic>

#include "tempera/core/animated.h"
#include "tempera/core/error.h"
#include "tempera/core/parallel.h"
#include "tempera/core/params.h"
#include "tempera/core/time.h"
#include "tempera/core/vec.h"

namespace tempera {
namespace {

TEST(FrameSet, ReadsAllFourSpellings) {
  EXPECT_EQ(parse_frame_set("1-4"), (std::vector{1, 2, 3, 4}));
  EXPECT_EQ(parse_frame_set("1..4"), (std::vector{1, 2, 3, 4}));
  EXPECT_EQ(parse_frame_set("1-10x3"), (std::vector{1, 4, 7, 10}));
  EXPECT_EQ(parse_frame_set("1-10:3"), (std::vector{1, 4, 7, 10}));
  EXPECT_EQ(parse_frame_set("5,1001, 7-8,5"), (std::vector{5, 1001, 7, 8}));
  EXPECT_EQ(parse_frame_set("-3--1"), (std::vector{-3, -2, -1}));
}

TEST(FrameSet, RejectsWhatItCannotRead) {
  for (const char* bad : {"", "a", "1-", "4-1", "1-4x0", "1,,2", "1;2", "1-999999999"}) {
    try {
      parse_frame_set(bad);
      ADD_FAILURE() << "accepted \"" << bad << "\"";
    } catch (const Error& e) {
      EXPECT_EQ(exit_status(e.code()), 2) << bad;
    }
  }
}

TEST(FramePath, PadsAndSigns) {
  EXPECT_EQ(frame_path("out/f.####.exr", 7), "out/f.0007.exr");
  EXPECT_EQ(frame_path("out/f.%04d.exr", 1001), "out/f.1001.exr");
  EXPECT_EQ(frame_path("out/f.$F4.exr", 12345), "out/f.12345.exr");
  EXPECT_EQ(frame_path("f_##_.exr", -3), "f_-3_.exr");
}

TEST(FramePath, KnowsThePlacesOfOtherPrograms) {
  for (const char* four : {"f.####.exr", "f.@@@@.exr", "f.%04d.exr", "f.$F4.exr", "f.<F4>.exr", "f.<frame4>.exr"}) {
    EXPECT_TRUE(has_frame_pattern(four)) << four;
    EXPECT_EQ(frame_path(four, 7), "f.0007.exr") << four;
    EXPECT_EQ(frame_path(four, -7), "f.-007.exr") << four;
  }
  for (const char* any : {"f.#.exr", "f.@.exr", "f.%d.exr", "f.$F.exr", "f.<frame>.exr"}) {
    EXPECT_EQ(frame_path(any, 7), "f.7.exr") << any;
    EXPECT_EQ(frame_path(any, 1001), "f.1001.exr") << any;
  }
}

TEST(FramePath, LeavesNamesWithoutAPlaceAlone) {
  for (const char* one :
       {"f.exr", "a#b/f.exr", "f@2x.exr", "f_50%.exr", "f%s.exr", "<layer>.exr", "me@home.exr", "%"}) {
    EXPECT_FALSE(has_frame_pattern(one)) << one;
    EXPECT_EQ(frame_path(one, 3), one);
  }
  EXPECT_EQ(numbered_pattern("f.exr"), "f.####.exr");
  EXPECT_EQ(numbered_pattern("a.b/f"), "a.b/f.####");
  EXPECT_EQ(numbered_pattern("a/.f"), "a/.f.####");
  EXPECT_EQ(numbered_pattern("f.@@.exr"), "f.@@.exr");
}

TEST(Shutter, WarpFollowsTheShape) {
  for (const ShutterShape shape : {ShutterShape::kBox, ShutterShape::kTrapezoid, ShutterShape::kCurve}) {
    Shutter s;
    s.shape = shape;
    s.curve = {0, 1, 1, 0};
    s.ramp_in = s.ramp_out = 1.0 / 3;
    // Cumulative distribution of the trapezoid with ramps of a third: the curve above is the same shape.
    const auto cdf = [&](double x) {
      if (shape == ShutterShape::kBox) return x;
      const double y = x < 1.0 / 3 ? 1.5 * x * x : x > 2.0 / 3 ? 2.0 / 3 - 1.5 * (1 - x) * (1 - x) : x - 1.0 / 6;
      return y / (2.0 / 3);
    };
    for (double u = 0; u < 1; u += 0.03125) EXPECT_NEAR(cdf(s.warp(u)), u, 1e-12);
  }
}

TEST(Shutter, DensityIsThatOfWarp) {
  std::vector<Shutter> shutters(5);
  shutters[1].shape = shutters[2].shape = ShutterShape::kTrapezoid;
  shutters[2].ramp_in = 0.7, shutters[2].ramp_out = 0.6;  // more than there is: clamped
  shutters[3].shape = shutters[4].shape = ShutterShape::kCurve;
  shutters[3].curve = {0, 2, 0.5f, 0, 1};
  for (const Shutter& s : shutters) {
    // The integral up to warp(u) is u.
    double integral = 0, x = 0;
    for (int i = 1; i <= 1000; ++i) {
      const double u = i / 1000.0, end = i == 1000 ? 1 : s.warp(u);
      const int n = 200;
      for (int k = 0; k < n; ++k) integral += s.density(x + (end - x) * (k + 0.5) / n) * (end - x) / n;
      x = end;
      ASSERT_NEAR(integral, u, 2e-5) << "shape " << int(s.shape) << " ramp " << s.ramp_in;
    }
    EXPECT_EQ(s.density(-0.01), 0);
    EXPECT_EQ(s.density(1.01), 0);
  }
}

// Overlapping, gapped and rolling shutters: every time of an exposure is found to be open and has a density, of which
// the integral is 1.
TEST(FrameClock, KnowsWhichFramesAreOpen) {
  for (const double rolling : {0.0, 0.4, -0.4}) {
    for (const double close : {0.5, 1.0, 2.6}) {
      FrameClock clock{.fps = 25, .first = 101, .start = 7, .shutter = {}};
      clock.shutter.open = -0.25, clock.shutter.close = close, clock.shutter.rolling = rolling;
      for (const int frame : {-3, 101, 240}) {
        for (const double v : {0.0, 0.3, 1.0}) {
          for (const double u : {0.0, 0.1, 0.77, 0x1.fffffep-1}) {
            const double t = clock.exposure_time(frame, u, v);
            const auto open = clock.frames_open_at(t);
            ASSERT_TRUE(open && open->contains(frame));
            EXPECT_NEAR(clock.exposure_density(frame, t, v), 25 / (close + 0.25), 1e-9);
            for (int f = open->first - 4; f <= open->last + 4; ++f) {
              EXPECT_EQ(open->contains(f), clock.exposure(f).contains(t)) << f;
              if (!open->contains(f)) {
                EXPECT_EQ(clock.exposure_density(f, t, v), 0);
              }
            }
          }
          const TimeSpan span = clock.exposure(frame);
          double integral = 0;
          const int n = 20000;
          for (int i = 0; i < n; ++i) {
            integral +=
                clock.exposure_density(frame, span.begin + span.length() * (i + 0.5) / n, v) * span.length() / n;
          }
          EXPECT_NEAR(integral, 1, 1e-3);
        }
      }
      const double between = clock.time(120) + (close + 0.2) / 25;  // closed in every line, if there is a gap
      EXPECT_EQ(clock.frames_open_at(between).has_value(), rolling != 0 || close > 0.5);
    }
  }
  FrameClock instant;
  instant.shutter.close = 0;
  EXPECT_TRUE(instant.frames_open_at(instant.time(5)));
  EXPECT_FALSE(instant.frames_open_at(instant.time(5) + 0.01));
}

TEST(Animated, InterpolatesAndClamps) {
  const Animated<float> linear({1, 3}, {10, 20}, Interpolation::kLinear);
  EXPECT_EQ(linear.at(0), 10);
  EXPECT_EQ(linear.at(2), 15);
  EXPECT_EQ(linear.at(9), 20);
  const Animated<float> step({1, 3}, {10, 20}, Interpolation::kStep);
  EXPECT_EQ(step.at(2.99), 10);
  EXPECT_EQ(step.at(3), 20);
  // x(t) = t^3 on [0,2]: Hermite interpolation is exact for cubics.
  const Animated<double> cubic({0, 2}, {0, 0, 0, 12, 8, 12}, Interpolation::kCubic);
  for (double t = 0; t <= 2; t += 0.25) EXPECT_NEAR(cubic.at(t), t * t * t, 1e-12);
}

TEST(Animated, RotatesAlongTheShorterArc) {
  const Quatd a = axis_angle(Vec3d{0, 0, 1}, 0.0), b = -axis_angle(Vec3d{0, 0, 1}, kPiD / 2);
  const Animated<Quatd> r({0, 1}, {a, b}, Interpolation::kLinear);
  const Vec3d v = rotation(r.at(0.5)).vector({1, 0, 0});
  EXPECT_NEAR(v.x, std::sqrt(0.5), 1e-12);
  EXPECT_NEAR(v.y, std::sqrt(0.5), 1e-12);
}

TEST(Affine, InverseAndQuaternionRoundTrip) {
  const Quatd q = normalize(Quatd{0.3, -0.5, 0.7, 0.2});
  Affine3d m = rotation(q);
  const Quatd back = quaternion(m);
  EXPECT_NEAR(std::abs(dot(q, back)), 1, 1e-12);
  m.translation = {1, 2, 3};
  m.x *= 3.0;
  const Vec3d p{0.4, -2, 5};
  EXPECT_NEAR(length(inverse(m).point(m.point(p)) - p), 0, 1e-12);
}

TEST(Basis, IsOrthonormalForAllNormals) {
  for (int i = 0; i < 1000; ++i) {
    const float z = 1 - 2 * (float(i) + 0.5f) / 1000, phi = 2.4f * float(i), r = std::sqrt(1 - z * z);
    const Basis b(Vec3f{r * std::cos(phi), r * std::sin(phi), z});
    EXPECT_NEAR(dot(b.s, b.t), 0, 1e-6);
    EXPECT_NEAR(length(cross(b.s, b.t) - b.n), 0, 1e-6);
  }
}

TEST(Params, ReportsNameTypeAndRange) {
  const std::vector<ParamSpec> table{{"spp", 16, "samples", 1, 1e6},
                                     {"filter", std::string("box"), "filter", 0, 0, {"box", "tent"}}};
  Params p(table);
  p.set_text("spp", "64");
  EXPECT_EQ(p.get_int("spp"), 64);
  EXPECT_EQ(p.canonical(), "spp=64,filter=box");
  const auto code = [&](const char* name, const char* text) {
    try {
      p.set_text(name, text, {"shot.toml", 3, 5});
    } catch (const Error& e) {
      EXPECT_EQ(e.loc().line, 3);
      return e.code();
    }
    return ErrorCode::kFailed;
  };
  EXPECT_EQ(code("sp", "1"), ErrorCode::kUnknownName);
  EXPECT_EQ(code("spp", "1.5"), ErrorCode::kBadInput);
  EXPECT_EQ(code("spp", "0"), ErrorCode::kOutOfRange);
  EXPECT_EQ(code("filter", "bix"), ErrorCode::kUnknownName);
}

TEST(Parallel, VisitsEveryIndexOnceWithMoreThreadsThanCores) {
  for (const int threads : {1, 2, 7}) {
    std::vector<std::atomic<int>> hits(10000);
    with_threads(threads, [&] {
      parallel_for(
          0, 10000, [&](std::int64_t i) { ++hits[i]; }, 16);
    });
    for (const auto& h : hits) EXPECT_EQ(h, 1);
  }
}

TEST(Error, LocatesAndShowsExitStatus) {
  const SourceLoc loc = locate("f", "ab\ncd\nef", 4);
  EXPECT_EQ(loc.line, 2);
  EXPECT_EQ(loc.column, 2);
  EXPECT_EQ(Error(ErrorCode::kSyntax, loc, "bad").what(), std::string("f:2:2: bad"));
  EXPECT_EQ(exit_status(ErrorCode::kMissingFile), 4);
}

}  // namespace
}  // namespace tempera
