// SPDX-License-Identifier: Apache-2.0
// The stage upsample on light whose large picture is known.
#include <gtest/gtest.h>

#include "motion/tests/moving_pictures.h"
#include "tempera/core/parallel.h"

namespace tempera {
namespace {

using test::mean_square;
using test::waves;

constexpr int kWidth = 48, kHeight = 32;  // of the large frames

Image halved(const Image& in) {
  Image out(in.width() / 2, in.height() / 2, in.channels());
  for (int y = 0; y < out.height(); ++y) {
    for (int x = 0; x < out.width(); ++x) {
      for (int c = 0; c < in.channels(); ++c) {
        out.at(x, y, c) = (in.at(2 * x, 2 * y, c) + in.at(2 * x + 1, 2 * y, c) + in.at(2 * x, 2 * y + 1, c) +
                           in.at(2 * x + 1, 2 * y + 1, c)) /
                          4;
      }
    }
  }
  return out;
}

class Upsample : public test::FrameFiles {
 protected:
  /// A fine texture of reflectance.
  static Frame guide() {
    Frame f(kWidth, kHeight);
    Image &color = f.create(layers::color()), &albedo = f.create(layers::albedo());
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        albedo.set_rgb(x, y, waves(2.5f * float(x), 3 * float(y)));
        color.at(x, y, 3) = 1;
      }
    }
    return f;
  }
  static Frame small(const Image& color) {
    Frame f(kWidth / 2, kHeight / 2);
    f.add(layers::color(), halved(color));
    f.create(layers::albedo());
    return f;
  }
  Frame enlarged(const Frame& in, const Frame& guides) const {
    write("in", 3, in);
    write("guides", 3, guides);
    run("upsample", {"in", "guides"}, "out");
    return read("out", 3);
  }
};

TEST_F(Upsample, LightThatFollowsTheGuidesComesBack) {
  const Frame guides = guide();
  Image truth = guides.layer("color");
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {  // linear in the reflectance everywhere
      const Rgb a = guides.layer("albedo").rgb(x, y);
      truth.set_rgb(x, y, a * 3.0f + Rgb(0.2f, 0.1f + 0.5f * a.r, 0));
    }
  }
  const Frame out = enlarged(small(truth), guides);
  EXPECT_LT(mean_square(out.layer("color"), truth), 1e-5);
  EXPECT_EQ(out.layer("albedo"), guides.layer("albedo"));
  EXPECT_EQ(*std::max_element(out.layer("mask").values().begin(), out.layer("mask").values().end()), 0);

  Frame plain = guides;  // what smoothing alone would do
  plain.add(layers::albedo(), Image(kWidth, kHeight, 3, 0.5f));
  EXPECT_GT(mean_square(enlarged(small(truth), plain).layer("color"), truth), 0.01);
}

// A texture, and another one that is mirrored in it.
TEST_F(Upsample, EachClassFollowsItsOwnGuides) {
  Frame guides = guide();
  const Image texture = guides.layer("albedo");
  Image mirrored(kWidth, kHeight, 3), normal(kWidth, kHeight, 3);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      mirrored.set_rgb(x, y, waves(3 * float(y) + 40, 2.2f * float(x)));
      normal.set_vec3(x, y, {0, 0, 1});
    }
  }
  guides.add(layers::chain_layer("D", layers::albedo()), texture);
  guides.add(layers::chain_layer("RD", layers::albedo()), mirrored);
  guides.add(layers::chain_layer("RD", layers::normal()), normal);
  Image truth = guides.layer("color"), direct(kWidth, kHeight, 3), reflection(kWidth, kHeight, 3);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      // Their shares vary, so that their sum is linear in neither.
      const float light = 2 + std::sin(0.3f * float(x)), other = 2 + std::cos(0.3f * float(y));
      direct.set_rgb(x, y, texture.rgb(x, y) * light), reflection.set_rgb(x, y, mirrored.rgb(x, y) * other);
      truth.set_rgb(x, y, direct.rgb(x, y) + reflection.rgb(x, y));
    }
  }
  const Frame whole = small(truth);
  Frame parts = whole;
  parts.add(layers::class_layer("direct", layers::color()), halved(direct));
  parts.add(layers::class_layer("reflection", layers::color()), halved(reflection));
  parts.add(layers::class_layer("residual", layers::color()), Image(kWidth / 2, kHeight / 2, 3));
  set_classes(parts.metadata, std::vector<ClassInfo>{{"direct", "ED.*", {"D"}}, {"reflection", "ERD.*", {"RD"}}});
  const Frame together = enlarged(whole, guides), apart = enlarged(parts, guides);
  EXPECT_LT(1.5 * mean_square(apart.layer("color"), truth), mean_square(together.layer("color"), truth));
  EXPECT_FALSE(together.has("class.direct.color"));
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      if (apart.layer("mask").at(x, y) > 0) continue;
      const Rgb sum = apart.layer("class.direct.color").rgb(x, y) + apart.layer("class.reflection.color").rgb(x, y) +
                      apart.layer("class.residual.color").rgb(x, y);
      for (int c = 0; c < 3; ++c) ASSERT_NEAR(sum[c], apart.layer("color").at(x, y, c), 0.03f * sum[c]);
    }
  }
}

TEST_F(Upsample, LightThatVariesSlowlyOnATextureIsNear) {
  const Frame guides = guide();
  Image truth = guides.layer("color");
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      truth.set_rgb(x, y,
                    guides.layer("albedo").rgb(x, y) * (2 + std::sin(0.15f * float(x)) + std::cos(0.2f * float(y))));
    }
  }
  EXPECT_LT(mean_square(enlarged(small(truth), guides).layer("color"), truth), 2e-3);
}

// A disk a hundred times as bright as the texture before which it hangs.
TEST_F(Upsample, LampsDoNotLeakOverTheirEdges) {
  Frame guides = guide();
  Image truth = guides.layer("color"), &emission = guides.create(layers::emission());
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const float share = std::clamp(8.5f - std::hypot(float(x) - 21.3f, float(y) - 15.8f), 0.0f, 1.0f);
      const Rgb albedo = guides.layer("albedo").rgb(x, y) * (1 - share);
      guides.layer("albedo").set_rgb(x, y, albedo), emission.set_rgb(x, y, Rgb(50 * share));
      truth.set_rgb(x, y, albedo + Rgb(50 * share));
    }
  }
  Frame in = small(truth);
  const double without = mean_square(enlarged(in, guides).layer("color"), truth);
  in.add(layers::emission(), halved(emission));
  const Frame out = enlarged(in, guides);
  EXPECT_LT(mean_square(out.layer("color"), truth), 1e-3);
  EXPECT_LT(100 * mean_square(out.layer("color"), truth), without);
  EXPECT_EQ(out.layer("emission"), emission);

  // The same light as a class of its own.
  Image direct(kWidth, kHeight, 3);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) direct.set_rgb(x, y, truth.rgb(x, y) - emission.rgb(x, y));
  }
  in.add(layers::class_layer("emission", layers::color()), halved(emission));
  in.add(layers::class_layer("direct", layers::color()), halved(direct));
  in.add(layers::class_layer("residual", layers::color()), Image(kWidth / 2, kHeight / 2, 3));
  set_classes(in.metadata, std::vector<ClassInfo>{{"emission", "E", {}}, {"direct", "ED.*", {"D"}}});
  EXPECT_LT(mean_square(enlarged(in, guides).layer("color"), truth), 1e-3);
}

TEST_F(Upsample, NothingLeaksOverTheBackground) {
  Frame guides = guide();
  Image truth = guides.layer("color");
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const bool there = y < 19;
      if (!there) guides.layer("albedo").set_rgb(x, y, Rgb(0.0f));
      guides.layer("color").at(x, y, 3) = truth.at(x, y, 3) = there;
      if (!there) guides.layer("color").set_rgb(x, y, Rgb(0.01f));
      truth.set_rgb(x, y, there ? guides.layer("albedo").rgb(x, y) * float(y) : Rgb(0.01f));
    }
  }
  const Frame out = enlarged(small(truth), guides);
  for (int y = 19; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      ASSERT_EQ(out.layer("color").rgb(x, y), Rgb(0.01f)) << x << "," << y;
      ASSERT_EQ(out.layer("color").at(x, y, 3), 0) << x << "," << y;
      ASSERT_EQ(out.layer("mask").at(x, y), 0) << x << "," << y;
    }
  }
}

TEST_F(Upsample, WithoutGuidesItIsBilinear) {
  Frame guides = guide();
  guides.add(layers::albedo(), Image(kWidth, kHeight, 3, 0.5f));
  Image spot(kWidth, kHeight, 4);
  for (const int k : {0, 1, 2, 3}) spot.set_rgb(20 + k % 2, 10 + k / 2, Rgb(81.0f));
  const Image out = enlarged(small(spot), guides).layer("color");
  EXPECT_NEAR(out.at(20, 10, 0), 81 * 0.75f * 0.75f, 1e-4f);
  EXPECT_NEAR(out.at(22, 10, 0), 81 * 0.25f * 0.75f, 1e-4f);
  EXPECT_NEAR(out.at(24, 10, 0), 0.0f, 1e-4f);
  double sum = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) sum += double(out.at(x, y, 0));
  }
  EXPECT_NEAR(sum, 4 * 81, 1e-2) << "light is kept";
}

TEST_F(Upsample, NegativeLightIsLeftToTheRenderer) {
  Frame guides = guide();
  Image truth(kWidth, kHeight, 4);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {  // bright where the reflectance is above .5, black else: not linear in it
      const float a = guides.layer("albedo").at(x, y, 0);
      truth.set_rgb(x, y, Rgb(a > 0.6f ? 10.0f : 0.0f));
    }
  }
  const Frame out = enlarged(small(truth), guides);
  int masked = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      masked += out.layer("mask").at(x, y) > 0;
      for (int c = 0; c < 3; ++c) EXPECT_GE(out.layer("color").at(x, y, c), 0);
    }
  }
  EXPECT_GT(masked, 0);
}

TEST_F(Upsample, DamagedValuesDoNotSpread) {
  const float bad[] = {NAN, INFINITY, -INFINITY, 3e38f, -3e38f};
  Frame guides = guide(), in = small(guides.layer("color"));
  guides.create(layers::emission()), guides.create(layers::normal());
  guides.create(layers::chain_layer("D", layers::albedo()));
  int at = 0;
  for (Frame* f : {&in, &guides}) {
    const std::list<Layer>& all = f->layers();
    for (const Layer& l : all) {
      for (const float v : bad) f->layer(l.desc.name).at(1 + 2 * (at % 10), 1 + at / 10, 0) = v, ++at;
    }
  }
  const Image out = enlarged(in, guides).layer("color");
  for (const float v : out.values()) ASSERT_LT(std::abs(v), 1e6f);
}

TEST_F(Upsample, TheSameBitsInAnyDivision) {
  for (const int t : {1, 2, 3}) {
    Frame guides = guide();
    Image truth = guides.layer("color");
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) truth.set_rgb(x, y, waves(float(x * t), float(y)));
    }
    write("in", t, small(truth));
    write("guides", t, guides);
  }
  with_threads(1, [&] { run("upsample", {"in", "guides"}, "all"); });
  with_threads(5, [&] {
    for (const int t : {3, 1, 2}) run("upsample", {"in", "guides"}, "each", {}, {t});
  });
  for (const int t : {1, 2, 3}) EXPECT_EQ(read("all", t).layer("color"), read("each", t).layer("color"));
}

TEST_F(Upsample, SaysWhatIsMissing) {
  const auto error = [&](const Frame& in, const Frame& guides) {
    try {
      enlarged(in, guides);
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kBadInput);
      return e.message();
    }
    return std::string("no error");
  };
  EXPECT_EQ(error(guide(), guide()), "the frames have 48x32 pixels, so guides have 96x64, not 48x32");
  Frame without = guide();
  without.remove("albedo");
  EXPECT_NE(error(small(guide().layer("color")), without).find("has no layer \"albedo\": the frames have it"),
            std::string::npos);
}

}  // namespace
}  // namespace tempera
