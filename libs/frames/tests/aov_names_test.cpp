// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/aov_names.h"

#include <OpenImageIO/imageio.h>

#include "tempera/frames/cryptomatte.h"
#include "tempera/frames/frame.h"
#include "test_files.h"

namespace tempera {
namespace {
using test::same_bits;

std::vector<std::string> file_names(const std::vector<LayerDesc>& layers, AovNames names) {
  std::vector<std::string> out;
  for (const AovChannel& c : aov_channels(layers, names)) out.push_back(c.name);
  return out;
}
using Names = std::vector<std::string>;

TEST(AovNames, Blender) {
  const std::vector<LayerDesc> layers{layers::color(), layers::depth(), layers::albedo(), layers::normal(),
                                      layers::crypto(0)};
  EXPECT_EQ(file_names(layers, AovNames::kBlender),
            (Names{"ViewLayer.Combined.R", "ViewLayer.Combined.G", "ViewLayer.Combined.B", "ViewLayer.Combined.A",
                   "ViewLayer.Depth.Z", "ViewLayer.Denoising Albedo.R", "ViewLayer.Denoising Albedo.G",
                   "ViewLayer.Denoising Albedo.B", "ViewLayer.Normal.X", "ViewLayer.Normal.Y", "ViewLayer.Normal.Z",
                   "ViewLayer.CryptoObject00.r", "ViewLayer.CryptoObject00.g", "ViewLayer.CryptoObject00.b",
                   "ViewLayer.CryptoObject00.a"}));
  // As in files that Cycles of Blender 5.2.3 wrote.
  EXPECT_EQ(file_names({layers::color(), layers::uv(), layers::emission(), layers::object_id(), layers::samples()},
                       AovNames::kBlender),
            (Names{"ViewLayer.Combined.R", "ViewLayer.Combined.G", "ViewLayer.Combined.B", "ViewLayer.Combined.A",
                   "ViewLayer.UV.U", "ViewLayer.UV.V", "ViewLayer.UV.A", "ViewLayer.Emission.R", "ViewLayer.Emission.G",
                   "ViewLayer.Emission.B", "ViewLayer.Object Index.X", "ViewLayer.samples.N"}));
  EXPECT_EQ(cryptomatte_key("ViewLayer.CryptoObject"), "542cafa");
  EXPECT_EQ(aov_channels({layers::depth()}, AovNames::kBlender, "Layer 2")[0].name, "Layer 2.Depth.Z");
  // Signs: X, Y = previous - current, Z, W = current - next, with y up where ours points down.
  const auto motion = aov_channels({layers::motion_forward(), layers::motion_backward()}, AovNames::kBlender);
  const std::vector<AovChannel> vector(motion.end() - 4, motion.end());
  EXPECT_EQ(vector, (std::vector<AovChannel>{{"ViewLayer.Vector.X", "motion.backward", 0},
                                             {"ViewLayer.Vector.Y", "motion.backward", 1, {-1}},
                                             {"ViewLayer.Vector.Z", "motion.forward", 0, {-1}},
                                             {"ViewLayer.Vector.W", "motion.forward", 1}}));
  EXPECT_EQ(motion[0].name, "ViewLayer.motion_forward.X");
}

TEST(AovNames, Arnold) {
  EXPECT_EQ(file_names({layers::color(), layers::color_variance(), layers::albedo(), layers::normal(), layers::depth(),
                        layers::crypto(1), layers::samples()},
                       AovNames::kArnold),
            (Names{"R", "G", "B", "A", "variance.R", "variance.G", "variance.B", "denoise_albedo.R", "denoise_albedo.G",
                   "denoise_albedo.B", "N.X", "N.Y", "N.Z", "Z", "crypto_object01.R", "crypto_object01.G",
                   "crypto_object01.B", "crypto_object01.A", "samples.N"}));
}

TEST(AovNames, Renderman) {
  EXPECT_EQ(file_names({layers::color(), layers::color_variance(), layers::albedo(), layers::depth(),
                        layers::motion_backward()},
                       AovNames::kRenderman),
            (Names{"R", "G", "B", "A", "mse.r", "mse.g", "mse.b", "albedo.r", "albedo.g", "albedo.b", "z", "backward.x",
                   "backward.y"}));
}

TEST(AovNames, Pbrt) {
  EXPECT_EQ(file_names({layers::color(), layers::color_variance(), layers::albedo(), layers::normal(),
                        layers::position(), layers::uv()},
                       AovNames::kPbrt),
            (Names{"R", "G", "B", "A", "Variance.R", "Variance.G", "Variance.B", "Albedo.R", "Albedo.G", "Albedo.B",
                   "Ns.X", "Ns.Y", "Ns.Z", "P.X", "P.Y", "P.Z", "u", "v"}));
}

TEST(AovNames, DescriptionForTheLog) {
  EXPECT_EQ(describe_aov_names({layers::color(), layers::normal(), layers::depth()}, AovNames::kBlender),
            "color -> ViewLayer.Combined.{R,G,B,A}\nnormal -> ViewLayer.Normal.{X,Y,Z}\ndepth -> "
            "ViewLayer.Depth.Z\n");
  EXPECT_EQ(describe_aov_names({layers::color(), layers::normal()}, AovNames::kArnold),
            "color -> {R,G,B,A}\nnormal -> N.{X,Y,Z}\n");
}

class AovFile : public test::TestFolder {};

TEST_F(AovFile, EveryPresetReadsBackAsOurLayers) {
  Frame f(3, 2);
  float v = 1;
  for (const LayerDesc& d : layers::known()) {
    for (float& x : f.create(d).values()) x = v++;
  }
  for (const char* name : {"class.dd.color", "class.s_s.motion.forward", "offset.grad.x"}) {
    for (float& x : f.create(*layers::find(name)).values()) x = v++;
  }
  CryptomatteBuffer crypto(3, 2);
  crypto.add(1, 1, cryptomatte_id("cube"));
  crypto.write(f, {"cube"});
  for (const AovNames names :
       {AovNames::kTempera, AovNames::kBlender, AovNames::kArnold, AovNames::kRenderman, AovNames::kPbrt}) {
    write_frame(path("f.exr"), f, {.names = names});
    const Frame g = read_frame(path("f.exr"));
    EXPECT_EQ(g.layers().size(), f.layers().size()) << int(names);
    for (const Layer& l : f.layers()) {
      ASSERT_TRUE(g.has(l.desc.name)) << l.desc.name << " " << int(names);
      const LayerDesc& d = g.desc(l.desc.name);
      EXPECT_EQ(d.combine, l.desc.combine) << l.desc.name;
      if (names == AovNames::kRenderman && d.name.starts_with("motion.")) {  // x and y only
        EXPECT_EQ(d.channels, (Names{"X", "Y"}));
        EXPECT_EQ(g.layer(d.name).vec2(2, 1), l.image.vec2(2, 1));
        continue;
      }
      EXPECT_EQ(d, l.desc);
      EXPECT_TRUE(same_bits(g.layer(d.name), l.image)) << d.name << " " << int(names);
    }
    EXPECT_EQ(g.metadata, f.metadata) << int(names);
    EXPECT_EQ(cryptomatte_manifest(g.metadata).at("cube"), cryptomatte_id("cube"));
  }
  ReadOptions raw;
  raw.rename = false;
  write_frame(path("f.exr"), f, {.names = AovNames::kBlender});
  const Frame g = read_frame(path("f.exr"), raw);
  EXPECT_TRUE(g.has("ViewLayer.Combined"));
  EXPECT_TRUE(g.has("ViewLayer.Vector"));
  EXPECT_FALSE(g.has("color"));
  EXPECT_EQ(std::get<std::string>(g.metadata.at("cryptomatte/" + cryptomatte_key("ViewLayer.CryptoObject") + "/name")),
            "ViewLayer.CryptoObject");
}

TEST_F(AovFile, BlendersConventions) {
  // One pixel with a surface, one without. For us y is up, for Blender z; its pixel coordinates point up.
  Frame f(2, 1);
  f.create(layers::color()).set_rgb(0, 0, {1, 2, 3});
  f.layer("color").at(0, 0, 3) = 1;
  const auto set = [&](const LayerDesc& d, std::vector<float> values) {
    Image& image = f.create(d);
    for (int c = 0; c < d.channel_count(); ++c) image.at(0, 0, c) = values[c];
  };
  set(layers::depth(), {5});
  set(layers::position(), {1, 2, -7});  // 2 up, 7 away along -z: Blender's y axis
  set(layers::normal(), {0, 0.6f, 0.8f});
  set(layers::uv(), {0.25f, 0.125f});
  set(layers::motion_forward(), {3, -2, 0, 1});  // to the right and up
  set(layers::motion_backward(), {-1, 4, 0, 1});
  write_frame(path("f.exr"), f, {.names = AovNames::kBlender, .view_layer = "Layer"});
  ReadOptions raw;
  raw.rename = false;
  const Frame g = read_frame(path("f.exr"), raw);
  const auto at = [&](const char* pass, int x) {
    std::vector<float> out;
    const Image& image = g.layer(pass);
    for (int c = 0; c < image.channels(); ++c) out.push_back(image.at(x, 0, c));
    return out;
  };
  using V = std::vector<float>;
  EXPECT_EQ(at("Layer.Depth", 0), V{5});
  EXPECT_EQ(at("Layer.Depth", 1), V{1e10f});
  EXPECT_EQ(at("Layer.Position", 0), (V{1, 7, 2}));
  EXPECT_EQ(at("Layer.Position", 1), (V{0, 0, 0}));
  EXPECT_EQ(at("Layer.Normal", 0), (V{0, -0.8f, 0.6f}));
  EXPECT_EQ(at("Layer.UV", 0), (V{0.25f, 0.875f, 1}));
  EXPECT_EQ(at("Layer.UV", 1), (V{0, 0, 0}));
  EXPECT_EQ(at("Layer.Vector", 0), (V{-1, -4, -3, -2}));
  const Frame back = read_frame(path("f.exr"));
  for (const Layer& l : f.layers()) EXPECT_TRUE(same_bits(back.layer(l.desc.name), l.image)) << l.desc.name;
}

void write_channels(const std::string& path, Names names) {
  OIIO::ImageSpec spec(2, 1, int(names.size()), OIIO::TypeDesc::FLOAT);
  spec.channelnames = std::move(names);
  std::vector<float> data;
  for (int x = 0; x < 2; ++x) {
    for (int c = 0; c < spec.nchannels; ++c) data.push_back(float(10 * x + c + 1));
  }
  const auto out = OIIO::ImageOutput::create(path);
  ASSERT_TRUE(out && out->open(path, spec) && out->write_image(OIIO::TypeDesc::FLOAT, data.data()) && out->close());
}

TEST_F(AovFile, BlenderVectorsBecomeMotion) {
  write_channels(path("f.exr"),
                 {"View Layer.Combined.R", "View Layer.Combined.G", "View Layer.Combined.B", "View Layer.Combined.A",
                  "View Layer.Depth.V", "View Layer.Vector.X", "View Layer.Vector.Y", "View Layer.Vector.Z",
                  "View Layer.Vector.W", "View Layer.Mist.Z", "View Layer.UV.U", "View Layer.UV.V", "View Layer.UV.A"});
  const Frame f = read_frame(path("f.exr"));
  EXPECT_EQ(f.desc("color"), layers::color());
  EXPECT_EQ(f.layer("color").at(1, 0, 3), 14);
  EXPECT_EQ(f.desc("depth"), layers::depth());
  EXPECT_EQ(f.desc("motion.backward").channels, (Names{"X", "Y"}));
  EXPECT_EQ(f.layer("motion.backward").vec2(0, 0), (Vec2f{6, -7}));
  EXPECT_EQ(f.layer("motion.forward").vec2(0, 0), (Vec2f{-8, 9}));
  EXPECT_EQ(f.desc("uv"), layers::uv());
  EXPECT_EQ(f.layer("uv").vec2(0, 0), (Vec2f{11, 1 - 12})) << "v points up there; A stands first in the alphabet";
  EXPECT_TRUE(f.has("View Layer.Mist"));
  EXPECT_FALSE(f.has("View Layer.Vector"));
}

// What "Denoising Data" and "Vector" alone store, in the order of Cycles, and what the compositor adds.
TEST_F(AovFile, BlendersDenoisingData) {
  write_channels(path("f.exr"),
                 {"Composite.Combined.R", "Composite.Combined.G", "Composite.Combined.B", "Composite.Combined.A",
                  "ViewLayer.Combined.R", "ViewLayer.Combined.G", "ViewLayer.Combined.B", "ViewLayer.Combined.A",
                  "ViewLayer.Denoising Normal.X", "ViewLayer.Denoising Normal.Y", "ViewLayer.Denoising Normal.Z",
                  "ViewLayer.Denoising Albedo.R", "ViewLayer.Denoising Albedo.G", "ViewLayer.Denoising Albedo.B",
                  "ViewLayer.Denoising Depth.Z"});
  const Frame f = read_frame(path("f.exr"));
  EXPECT_EQ(f.layer("color").at(0, 0, 0), 5) << "of the view layer, whose other passes are there";
  EXPECT_TRUE(f.has("Composite.Combined"));
  EXPECT_EQ(f.layer("normal").vec3(0, 0), (Vec3f{9, 10, -11})) << "z points to the viewer for us";
  EXPECT_EQ(f.desc("normal").unit, "unit vector, camera space");
  EXPECT_EQ(f.layer("albedo").rgb(1, 0), (Rgb{22, 23, 24}));

  write_channels(path("g.exr"),
                 {"A.Combined.R", "A.Combined.G", "A.Combined.B", "A.Denoising Normal.X", "A.Denoising Normal.Y",
                  "A.Denoising Normal.Z", "A.Normal.X", "A.Normal.Y", "A.Normal.Z"});
  const Frame g = read_frame(path("g.exr"));
  EXPECT_EQ(g.layer("normal").vec3(0, 0), (Vec3f{7, 9, -8})) << "normals in world space are better";
  EXPECT_EQ(g.desc("normal"), layers::normal());
  EXPECT_TRUE(g.has("A.Denoising Normal"));
  write_channels(path("h.exr"), {"Composite.Combined.R", "Composite.Combined.G", "Composite.Combined.B"});
  EXPECT_EQ(read_frame(path("h.exr")).layer("color").at(0, 0, 2), 3);
}

TEST_F(AovFile, AmbiguousNamesStay) {
  write_channels(path("f.exr"), {"A.Combined.R", "A.Combined.G", "A.Combined.B", "B.Combined.R", "B.Combined.G",
                                 "B.Combined.B", "B.Depth.Z"});
  const Frame f = read_frame(path("f.exr"));
  EXPECT_EQ(f.layer_names(), (Names{"color", "B.Combined", "depth"}));
  write_channels(path("g.exr"),
                 {"R", "G", "B", "A.Combined.R", "A.Combined.G", "A.Combined.B", "depth.Z", "A.Depth.Z"});
  const Frame g = read_frame(path("g.exr"));
  EXPECT_EQ(g.layer("color").at(0, 0), 1) << "the plain channels are the picture";
  EXPECT_TRUE(g.has("A.Combined"));
  EXPECT_TRUE(g.has("A.Depth"));
}

TEST_F(AovFile, FilesOfOtherRenderers) {
  write_channels(path("mitsuba.exr"), {"B", "G", "R", "alb.B", "alb.G", "alb.R", "dd.T", "nn.X", "nn.Y", "nn.Z"});
  const Frame m = read_frame(path("mitsuba.exr"));
  EXPECT_EQ(m.layer("color").rgb(0, 0), (Rgb{3, 2, 1}));
  EXPECT_EQ(m.desc("color").channels, (Names{"R", "G", "B"}));
  EXPECT_EQ(m.desc("alb").channels, (Names{"R", "G", "B"}));
  EXPECT_EQ(m.desc("nn").channels, (Names{"X", "Y", "Z"}));
  EXPECT_EQ(m.desc("dd").channels, (Names{"T"}));

  write_channels(path("gray.exr"), {"Y", "A"});
  EXPECT_EQ(read_frame(path("gray.exr")).desc("color").channels, (Names{"Y", "A"}));
  EXPECT_EQ(read_frame(path("gray.exr")).layer("color").rgb(0, 0), Rgb(1.0f));

  write_channels(path("pbrt.exr"), {"R", "G", "B", "Albedo.R", "Albedo.G", "Albedo.B", "N.X", "N.Y", "N.Z", "Ns.X",
                                    "Ns.Y", "Ns.Z", "P.X", "P.Y", "P.Z", "u", "v", "dzdx", "dzdy"});
  const Frame p = read_frame(path("pbrt.exr"));
  for (const char* name : {"color", "albedo", "normal", "position", "uv", "N", "dzdx", "dzdy"})
    EXPECT_TRUE(p.has(name)) << name;
  EXPECT_EQ(p.desc("normal"), layers::normal());

  write_channels(path("arnold.exr"), {"R", "G", "B", "A", "N.X", "N.Y", "N.Z", "Z", "diffuse_albedo.R",
                                      "diffuse_albedo.G", "diffuse_albedo.B", "crypto_object00.R", "crypto_object00.G",
                                      "crypto_object00.B", "crypto_object00.A"});
  const Frame a = read_frame(path("arnold.exr"));
  EXPECT_EQ(a.layer_names().size(), 5u);
  for (const char* name : {"color", "normal", "depth", "albedo", "CryptoObject00"}) EXPECT_TRUE(a.has(name)) << name;

  write_channels(path("renderman.exr"), {"Ci.r", "Ci.g", "Ci.b", "Ci.a", "albedo.r", "albedo.g", "albedo.b", "z"});
  const Frame r = read_frame(path("renderman.exr"));
  EXPECT_EQ(r.desc("color"), layers::color());
  EXPECT_EQ(r.desc("albedo"), layers::albedo());
  EXPECT_TRUE(r.has("depth"));
}

}  // namespace
}  // namespace tempera
