// SPDX-License-Identifier: Apache-2.0
#include "tempera/transport/tile_film.h"

#include <functional>

#include "box_shot.h"

namespace tempera {
namespace {

/// A function of the random numbers of a path, and its integral.
struct Integrand {
  const char* name;
  double integral;
  std::function<float(const SampleStream&)> value;
};

const std::vector<Integrand> kIntegrands{
    {"smooth", 0.5 + 1.0 / 3,
     [](const SampleStream& s) {
       const Vec2f u = s.vertex(0).direction;
       return u.x + sqr(u.y);
     }},
    {"product", 1,
     [](const SampleStream& s) {
       float f = 1;
       for (std::uint32_t b = 0; b < 3; ++b) {
         const VertexNumbers u = s.vertex(b);
         f *= (0.5f + u.direction.x) * (0.5f + u.light_point.y);
       }
       return f;
     }},
    {"rare and bright", 0.1 + 20 * 0.01, [](const SampleStream& s) {
       return 0.1f + (s.vertex(0).direction.x < 0.1f && s.vertex(1).direction.y < 0.1f ? 20.0f : 0.0f);
     }}};

struct Film {
  explicit Film(int size) {
    shot.settings.width = shot.settings.height = size;
    shot.settings.layers = {"color", "color.a", "color.b", "color.var"};
  }
  /// A picture of `integrand`, with `spp` samples of each pixel; sample `bad` of each is not finite.
  Frame render(const Integrand& integrand, SamplerKind sampler, int spp, int bad = -1) const {
    GeometryCache cache;
    const RayScene rays(shot.scene, {0, 0}, {0, 0}, {}, cache);
    const LightSampler lights(shot.scene, rays);
    const CameraModel camera_model(shot.scene, 0, shot.settings.width, shot.settings.height, {0, 0}, 1);
    const LightPathClassifier classifier;
    const FrameContext context{shot.scene, rays, lights, camera_model, classifier, shot.settings, 0};
    const auto integrator = find_method("path").make(Params(find_method("path").params));
    Frame out = make_frame(*integrator, shot.settings, shot.scene);
    const Tile tile{0, 0, shot.settings.width, shot.settings.height};
    TileFilm film(context, tile, out);
    for (int y = 0; y < tile.y1; ++y) {
      for (int x = 0; x < tile.x1; ++x) {
        for (int i = 0; i < spp; ++i) {
          const SampleStream stream(sampler, 5, 0, x, y, std::uint32_t(i));
          SampleResult result;
          result.radiance = Rgb(i == bad ? std::numeric_limits<float>::quiet_NaN() : integrand.value(stream));
          EXPECT_EQ(film.add(x, y, i, {stream, 1, 0, {}, {}, {}}, result), i != bad);
        }
      }
    }
    film.write(out);
    return out;
  }
  BoxShot shot{make_diffuse(0.5f), nullptr};
};

/// Mean of color.var over the mean squared deviation of color.
double predicted_over_seen(const Frame& frame, double integral) {
  double predicted = 0, seen = 0;
  const Image &color = frame.layer("color"), &variance = frame.layer("color.var");
  for (int y = 0; y < color.height(); ++y) {
    for (int x = 0; x < color.width(); ++x) {
      predicted += double(variance.at(x, y));
      seen += sqr(double(color.at(x, y)) - integral);
    }
  }
  return predicted / seen;
}

TEST(TileFilm, VarianceIsThatOfTheMean) {
  const Film film(128);
  for (const Integrand& integrand : kIntegrands) {
    for (const SamplerKind sampler : {SamplerKind::kSobol, SamplerKind::kIndependent}) {
      for (const int spp : {2, 16, 64}) {
        const Frame frame = film.render(integrand, sampler, spp);
        const Image &a = frame.layer("color.a"), &b = frame.layer("color.b"), &variance = frame.layer("color.var");
        for (int x = 0; x < a.width(); ++x) {
          ASSERT_FLOAT_EQ(variance.at(x, 7), sqr(a.at(x, 7) - b.at(x, 7)) / 4);
        }
        EXPECT_NEAR(predicted_over_seen(frame, integrand.integral), 1, 0.1)
            << integrand.name << ", sampler " << int(sampler) << ", " << spp << " samples";
      }
    }
  }
}

TEST(TileFilm, HalvesAreIndependent) {
  const Film film(128);
  for (const Integrand& integrand : kIntegrands) {
    const Frame frame = film.render(integrand, SamplerKind::kSobol, 16);
    const Image &a = frame.layer("color.a"), &b = frame.layer("color.b");
    double product = 0, squares = 0;
    for (int y = 0; y < 128; ++y) {
      for (int x = 0; x < 128; ++x) {
        const double da = double(a.at(x, y)) - integrand.integral, db = double(b.at(x, y)) - integrand.integral;
        product += da * db, squares += 0.5 * (da * da + db * db);
      }
    }
    EXPECT_NEAR(product / squares, 0, 4.0 / 128) << integrand.name;  // 4 standard errors of 128^2 pairs
  }
}

// Of odd numbers the even samples are one more; with independent samples the variance is right to the letter.
TEST(TileFilm, OddNumbersOfSamples) {
  const Film film(128);
  for (const int spp : {3, 5, 17}) {
    const Integrand& integrand = kIntegrands[0];
    const Frame frame = film.render(integrand, SamplerKind::kIndependent, spp);
    const float n = float(spp), even = float(spp / 2 + 1), odd = float(spp / 2);
    for (int x = 0; x < 128; ++x) {
      const float a = frame.layer("color.a").at(x, 3), b = frame.layer("color.b").at(x, 3);
      ASSERT_NEAR(frame.layer("color").at(x, 3), (even * a + odd * b) / n, 1e-6f);
      ASSERT_NEAR(frame.layer("color.var").at(x, 3), sqr(a - b) * even * odd / (n * n), 1e-6f);
    }
    EXPECT_NEAR(predicted_over_seen(frame, integrand.integral), 1, 0.1) << spp;
  }
}

// One sample says nothing of its spread; its square is at least the variance, in the mean.
TEST(TileFilm, OneSampleClaimsNoCertainty) {
  const Film film(32);
  const Frame one = film.render(kIntegrands[1], SamplerKind::kSobol, 1);
  for (int x = 0; x < 32; ++x) {
    const float color = one.layer("color").at(x, 9);
    EXPECT_GT(color, 0);
    EXPECT_EQ(one.layer("color.a").at(x, 9), color);
    EXPECT_EQ(one.layer("color.b").at(x, 9), 0);
    EXPECT_EQ(one.layer("color.var").at(x, 9), sqr(color));
  }
  // The same where the other samples were not finite.
  const Frame left = film.render(kIntegrands[1], SamplerKind::kSobol, 2, 0);
  EXPECT_EQ(left.layer("color.a").at(4, 4), 0);
  EXPECT_EQ(left.layer("color.b").at(4, 4), left.layer("color").at(4, 4));
  EXPECT_EQ(left.layer("color.var").at(4, 4), sqr(left.layer("color").at(4, 4)));
}

}  // namespace
}  // namespace tempera
