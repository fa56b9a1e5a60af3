// SPDX-License-Identifier: Apache-2.0
#include "tempera/shading/texture.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "image.h"

namespace tempera {

Vec2f Texture::scalar_gradient(const ShadingPoint& point) const {
  constexpr float kStep = 1e-3f;
  const auto difference = [&](float du, float dv) {
    ShadingPoint a = point, b = point;
    a.uv += Vec2f{du, dv}, a.uv1 += Vec2f{du, dv};
    b.uv -= Vec2f{du, dv}, b.uv1 -= Vec2f{du, dv};
    return (scalar(a) - scalar(b)) / (2 * kStep);
  };
  return {difference(kStep, 0), difference(0, kStep)};
}

namespace {

// Sources of texels by storage; level 0 is the image itself.
struct Byte4 {
  const std::uint8_t* p;
  const float* table;
  explicit Byte4(const Image& i) : p(static_cast<const std::uint8_t*>(i.data)), table(byte_table(i.srgb).data()) {}
  Texel at(std::size_t i) const {
    const std::uint8_t* q = p + 4 * i;
    return {{table[q[0]], table[q[1]], table[q[2]], float(q[3]) * (1.0f / 255.0f)}};
  }
};
struct Byte1 {
  const std::uint8_t* p;
  const float* table;
  explicit Byte1(const Image& i) : p(static_cast<const std::uint8_t*>(i.data)), table(byte_table(i.srgb).data()) {}
  Texel at(std::size_t i) const { return {{table[p[i]], table[p[i]], table[p[i]], 1}}; }
};
struct Half4 {
  const std::uint16_t* p;
  explicit Half4(const Image& i) : p(static_cast<const std::uint16_t*>(i.data)) {}
  explicit Half4(const std::uint16_t* q) : p(q) {}
  Texel at(std::size_t i) const {
    const std::uint16_t* q = p + 4 * i;
    return {{half_to_float(q[0]), half_to_float(q[1]), half_to_float(q[2]), half_to_float(q[3])}};
  }
};
struct Half1 {
  const std::uint16_t* p;
  explicit Half1(const Image& i) : p(static_cast<const std::uint16_t*>(i.data)) {}
  Texel at(std::size_t i) const {
    const float v = half_to_float(p[i]);
    return {{v, v, v, 1}};
  }
};
struct Float4 {
  const float* p;
  explicit Float4(const Image& i) : p(static_cast<const float*>(i.data)) {}
  Texel at(std::size_t i) const { return {{p[4 * i], p[4 * i + 1], p[4 * i + 2], p[4 * i + 3]}}; }
};
struct Float1 {
  const float* p;
  explicit Float1(const Image& i) : p(static_cast<const float*>(i.data)) {}
  Texel at(std::size_t i) const { return {{p[i], p[i], p[i], 1}}; }
};
struct Pages {
  const Image* image;
  explicit Pages(const Image& i) : image(&i) {}
};

/// Brings a coordinate to where int conversion is safe, without changing which texels it wraps to.
float reduce(float u, Wrap wrap) {
  if (!std::isfinite(u)) return 0;
  switch (wrap) {
    case Wrap::kRepeat:
      return u - std::floor(u);
    case Wrap::kMirror:
      return u - 2 * std::floor(0.5f * u);
    default:
      return std::clamp(u, -2.0f, 3.0f);
  }
}
/// Index among n texels of one that lies at most one texel outside of where `reduce` brings coordinates; -1 where the
/// image is black.
int wrap_index(int i, int n, Wrap wrap) {
  switch (wrap) {
    case Wrap::kRepeat:
      return i < 0 ? i + n : i >= n ? i - n : i;
    case Wrap::kMirror:
      i = i < 0 ? i + 2 * n : i >= 2 * n ? i - 2 * n : i;
      return i < n ? i : 2 * n - 1 - i;
    case Wrap::kClamp:
      return std::clamp(i, 0, n - 1);
    case Wrap::kBlack:
      return i >= 0 && i < n ? i : -1;
  }
  return 0;
}

/// The four texels around a point and where it lies between them.
struct Corners {
  Texel c00, c10, c01, c11;
  float fx, fy;
  Texel bilinear() const {
    const Texel a = c00 * (1 - fx) + c10 * fx, b = c01 * (1 - fx) + c11 * fx;
    return a * (1 - fy) + b * fy;
  }
};

template <class Source>
class ImageTexture final : public Texture {
 public:
  ImageTexture(const ImageTextureParams& params, std::shared_ptr<const Image> image)
      : p_(params), image_(std::move(image)), source_(*image_) {}

  Rgb rgb(const ShadingPoint& point) const override { return color(lookup(point)); }
  float scalar(const ShadingPoint& point) const override {
    const Texel t = lookup(point);
    return p_.channel == Channel::kRgb ? inverted(t.c[0]) : color(t).r;
  }
  Rgb mean() const override { return color(image_->mean()); }

  Vec2f scalar_gradient(const ShadingPoint& point) const override {
    if (p_.filter == TextureFilter::kNearest) return {0, 0};
    const Corners c = corners(coordinates(point), 0);
    const auto value = [this](const Texel& t) { return p_.channel == Channel::kRgb ? t.c[0] : pick(t); };
    float dx = (1 - c.fy) * value(c.c10 - c.c00) + c.fy * value(c.c11 - c.c01);
    float dy = (1 - c.fx) * value(c.c01 - c.c00) + c.fx * value(c.c11 - c.c10);
    dx *= float(image_->width);
    dy *= float(p_.flip_v ? -image_->height : image_->height);
    const float sign = p_.invert ? -1.0f : 1.0f;
    return Vec2f{p_.transform.a * dx + p_.transform.d * dy, p_.transform.b * dx + p_.transform.e * dy} * sign;
  }

 private:
  Vec2f coordinates(const ShadingPoint& point) const {
    Vec2f uv = p_.transform(p_.uv_set == 0 ? point.uv : point.uv1);
    if (p_.flip_v) uv.y = 1 - uv.y;
    return {reduce(uv.x, p_.wrap_u), reduce(uv.y, p_.wrap_v)};
  }

  int levels() const {
    if constexpr (std::is_same_v<Source, Pages>)
      return image_->page_levels();
    else
      return 1 + int(image_->levels.size());
  }
  void size_of(int level, int& w, int& h) const {
    if constexpr (std::is_same_v<Source, Pages>) {
      image_->page_size(level, w, h);
    } else if (level == 0) {
      w = image_->width, h = image_->height;
    } else {
      const Image::Level& l = image_->levels[level - 1];
      w = l.width, h = l.height;
    }
  }
  Texel texel(int level, int width, int x, int y) const {
    if (x < 0 || y < 0) return {};
    if constexpr (std::is_same_v<Source, Pages>) {
      Texel t;
      image_->page_block(level, x, y, 1, 1, &t);
      return t;
    } else {
      const std::size_t i = std::size_t(y) * width + x;
      return level == 0 ? source_.at(i) : Half4(image_->levels[level - 1].texels.data()).at(i);
    }
  }

  Corners corners(const Vec2f& uv, int level) const {
    int w, h;
    size_of(level, w, h);
    const float x = uv.x * float(w) - 0.5f, y = uv.y * float(h) - 0.5f;  // texel centres lie at half integers
    const float x0 = std::floor(x), y0 = std::floor(y);
    const int i = int(x0), j = int(y0);
    const int i0 = wrap_index(i, w, p_.wrap_u), i1 = wrap_index(i + 1, w, p_.wrap_u);
    const int j0 = wrap_index(j, h, p_.wrap_v), j1 = wrap_index(j + 1, h, p_.wrap_v);
    if constexpr (std::is_same_v<Source, Pages>)
      if (i1 == i0 + 1 && j1 == j0 + 1 && i0 >= 0 && j0 >= 0) {  // one visit to the cache instead of four
        Texel t[4];
        image_->page_block(level, i0, j0, 2, 2, t);
        return {t[0], t[1], t[2], t[3], x - x0, y - y0};
      }
    return {texel(level, w, i0, j0),
            texel(level, w, i1, j0),
            texel(level, w, i0, j1),
            texel(level, w, i1, j1),
            x - x0,
            y - y0};
  }

  Texel lookup(const ShadingPoint& point) const {
    const Vec2f uv = coordinates(point);
    switch (p_.filter) {
      case TextureFilter::kNearest: {
        const int w = image_->width, h = image_->height;
        return texel(0, w, wrap_index(int(std::floor(uv.x * float(w))), w, p_.wrap_u),
                     wrap_index(int(std::floor(uv.y * float(h))), h, p_.wrap_v));
      }
      case TextureFilter::kBilinear:
        return corners(uv, 0).bilinear();
      case TextureFilter::kMipmap:
        return filtered(uv, point);
    }
    return {};
  }

  /// Trilinear, with several lookups along the longer axis of the footprint [McCormack 1999].
  Texel filtered(const Vec2f& uv, const ShadingPoint& point) const {
    const UvTransform& m = p_.transform;
    const auto map = [&](const Vec2f& d) {
      return Vec2f{m.a * d.x + m.b * d.y, (m.d * d.x + m.e * d.y) * (p_.flip_v ? -1.0f : 1.0f)};
    };
    Vec2f major = map(point.duv_dx), minor = map(point.duv_dy);
    const Vec2f size{float(image_->width), float(image_->height)};
    const auto texels = [&](const Vec2f& d) { return length(Vec2f{d.x * size.x, d.y * size.y}); };
    float long_axis = texels(major), short_axis = texels(minor);
    if (short_axis > long_axis) std::swap(major, minor), std::swap(long_axis, short_axis);
    if (!(long_axis > 1) || levels() == 1 || !std::isfinite(long_axis)) return corners(uv, 0).bilinear();
    constexpr int kMostLookups = 8;
    const int n = std::clamp(int(std::ceil(long_axis / std::max(short_axis, 1e-6f))), 1, kMostLookups);
    const float level = std::clamp(std::log2(std::max(long_axis / float(n), 1.0f)), 0.0f, float(levels() - 1));
    const int fine = int(level), coarse = std::min(fine + 1, levels() - 1);
    const float s = level - float(fine);
    Texel sum;
    for (int i = 0; i < n; ++i) {
      const Vec2f at = uv + major * ((float(i) + 0.5f) / float(n) - 0.5f);
      const Vec2f p{reduce(at.x, p_.wrap_u), reduce(at.y, p_.wrap_v)};
      sum = sum + corners(p, fine).bilinear() * ((1 - s) / float(n));
      if (s > 0) sum = sum + corners(p, coarse).bilinear() * (s / float(n));
    }
    return sum;
  }

  float pick(const Texel& t) const {
    switch (p_.channel) {
      case Channel::kR:
        return t.c[0];
      case Channel::kG:
        return t.c[1];
      case Channel::kB:
        return t.c[2];
      case Channel::kA:
        return t.c[3];
      default:
        return luminance(Rgb{t.c[0], t.c[1], t.c[2]});
    }
  }
  float inverted(float v) const { return p_.invert ? 1 - v : v; }
  Rgb color(const Texel& t) const {
    if (p_.channel == Channel::kRgb) return {inverted(t.c[0]), inverted(t.c[1]), inverted(t.c[2])};
    return Rgb(inverted(pick(t)));
  }

  ImageTextureParams p_;
  std::shared_ptr<const Image> image_;
  Source source_;
};

std::shared_ptr<const Texture> make_texture(const ImageTextureParams& p, std::string_view encoded,
                                            const std::string& name, const SourceLoc& loc) {
  ImageRequest request;
  request.file = p.file;
  request.encoded = encoded;
  request.name = name;
  request.auto_encoding = p.encoding == ColorEncoding::kAuto;
  request.srgb = p.encoding == ColorEncoding::kSrgb;
  request.mipmap = p.filter == TextureFilter::kMipmap;
  request.keep_negative = p.keep_negative;
  auto image = load_image(request, loc);
  if (image->repaired) {
    if (p.warnings)
      p.warnings->add(kRepairedTexels, loc);
    else
      log_warning(fmt::format("{}: {}", name, kRepairedTexels));
  }
  switch (image->format) {
    case TexelFormat::kByte1:
      return std::make_shared<ImageTexture<Byte1>>(p, std::move(image));
    case TexelFormat::kByte4:
      return std::make_shared<ImageTexture<Byte4>>(p, std::move(image));
    case TexelFormat::kHalf1:
      return std::make_shared<ImageTexture<Half1>>(p, std::move(image));
    case TexelFormat::kHalf4:
      return std::make_shared<ImageTexture<Half4>>(p, std::move(image));
    case TexelFormat::kFloat1:
      return std::make_shared<ImageTexture<Float1>>(p, std::move(image));
    case TexelFormat::kFloat4:
      return std::make_shared<ImageTexture<Float4>>(p, std::move(image));
    case TexelFormat::kPaged:
      return std::make_shared<ImageTexture<Pages>>(p, std::move(image));
  }
  return nullptr;
}

class Checkerboard final : public Texture {
 public:
  Checkerboard(Slot color0, Slot color1, const UvTransform& transform)
      : color0_(std::move(color0)), color1_(std::move(color1)), transform_(transform) {}
  Rgb rgb(const ShadingPoint& point) const override { return slot(point).rgb(point); }
  float scalar(const ShadingPoint& point) const override { return slot(point).scalar(point); }
  Vec2f scalar_gradient(const ShadingPoint&) const override { return {0, 0}; }
  Rgb mean() const override { return (color0_.mean() + color1_.mean()) * 0.5f; }

 private:
  const Slot& slot(const ShadingPoint& point) const {
    const Vec2f uv = transform_(point.uv);
    const bool right = uv.x - std::floor(uv.x) > 0.5f, top = uv.y - std::floor(uv.y) > 0.5f;
    return right == top ? color0_ : color1_;
  }
  Slot color0_, color1_;
  UvTransform transform_;
};

class VertexColor final : public Texture {
 public:
  explicit VertexColor(float scale) : scale_(scale) {}
  Rgb rgb(const ShadingPoint& point) const override { return point.color * scale_; }
  Vec2f scalar_gradient(const ShadingPoint&) const override { return {0, 0}; }
  Rgb mean() const override { return Rgb(scale_); }

 private:
  float scale_;
};

class VertexAlpha final : public Texture {
 public:
  Rgb rgb(const ShadingPoint& point) const override { return Rgb(point.color_alpha); }
  float scalar(const ShadingPoint& point) const override { return point.color_alpha; }
  Vec2f scalar_gradient(const ShadingPoint&) const override { return {0, 0}; }
  Rgb mean() const override { return Rgb(1.0f); }
};

class Product final : public Texture {
 public:
  Product(std::shared_ptr<const Texture> a, std::shared_ptr<const Texture> b) : a_(std::move(a)), b_(std::move(b)) {}
  Rgb rgb(const ShadingPoint& point) const override { return a_->rgb(point) * b_->rgb(point); }
  float scalar(const ShadingPoint& point) const override { return a_->scalar(point) * b_->scalar(point); }
  Vec2f scalar_gradient(const ShadingPoint& point) const override {
    return a_->scalar_gradient(point) * b_->scalar(point) + b_->scalar_gradient(point) * a_->scalar(point);
  }
  Rgb mean() const override { return a_->mean() * b_->mean(); }

 private:
  std::shared_ptr<const Texture> a_, b_;
};

}  // namespace

std::shared_ptr<const Texture> make_image_texture(const ImageTextureParams& params, const SourceLoc& loc) {
  return make_texture(params, {}, params.file.string(), loc);
}
std::shared_ptr<const Texture> make_image_texture(const ImageTextureParams& params, std::string_view encoded,
                                                  const std::string& name, const SourceLoc& loc) {
  if (encoded.empty()) throw Error(ErrorCode::kBadInput, loc, "image \"" + name + "\" is empty");
  return make_texture(params, encoded, name, loc);
}
std::shared_ptr<const Texture> make_checkerboard(Slot color0, Slot color1, const UvTransform& transform) {
  return std::make_shared<Checkerboard>(std::move(color0), std::move(color1), transform);
}
std::shared_ptr<const Texture> make_vertex_color(float scale) { return std::make_shared<VertexColor>(scale); }
std::shared_ptr<const Texture> make_vertex_alpha() { return std::make_shared<VertexAlpha>(); }
std::shared_ptr<const Texture> make_product(std::shared_ptr<const Texture> a, std::shared_ptr<const Texture> b) {
  return std::make_shared<Product>(std::move(a), std::move(b));
}

}  // namespace tempera
