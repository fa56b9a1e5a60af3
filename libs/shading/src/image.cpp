// SPDX-License-Identifier: Apache-2.0
#include "image.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/half.h>
#include <OpenImageIO/imagecache.h>
#include <OpenImageIO/imageio.h>
#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <bit>
#include <cstring>
#include <map>
#include <mutex>

#include "file_color_space.h"
#include "tempera/core/grid.h"
#include "tempera/core/log.h"

namespace tempera {

Image::~Image() = default;
void Image::page_block(int, int, int, int, int, Texel*) const {}
void Image::page_size(int, int& w, int& h) const { w = width, h = height; }

float half_to_float(std::uint16_t h) {
  half v;
  v.setBits(h);
  return v;
}
std::uint16_t float_to_half(float f) { return half(std::clamp(f, -65504.0f, 65504.0f)).bits(); }

const std::array<float, 256>& byte_table(bool srgb) {
  static const auto tables = [] {
    std::array<std::array<float, 256>, 2> t;
    for (int i = 0; i < 256; ++i) {
      t[0][i] = float(i) * (1.0f / 255.0f);
      t[1][i] = srgb_to_linear(float(i) * (1.0f / 255.0f));
    }
    return t;
  }();
  return tables[srgb];
}

namespace {

std::atomic<std::size_t> image_budget{std::size_t(1) << 30};
std::atomic<std::size_t> image_bytes{0};  ///< taken by decoded images that are alive

int channels_of(TexelFormat f) {
  return f == TexelFormat::kByte1 || f == TexelFormat::kHalf1 || f == TexelFormat::kFloat1 ? 1 : 4;
}
std::size_t bytes_of(TexelFormat f) {
  const std::size_t channels = channels_of(f);
  if (f == TexelFormat::kByte1 || f == TexelFormat::kByte4) return channels;
  return f == TexelFormat::kHalf1 || f == TexelFormat::kHalf4 ? 2 * channels : 4 * channels;
}

/// Which channels of a file are red, green, blue and alpha; -1: none.
struct Channels {
  std::array<int, 4> index{-1, -1, -1, -1};
  bool gray() const { return index[1] < 0 && index[3] < 0; }
};
Channels find_channels(const OIIO::ImageSpec& spec) {
  Channels c;
  static constexpr const char* kNames[] = {"R", "G", "B", "A"};
  for (int i = 0; i < 4; ++i) c.index[i] = spec.channelindex(kNames[i]);
  if (c.index[0] >= 0 && c.index[1] >= 0 && c.index[2] >= 0) return c;
  const int n = spec.nchannels;
  c.index = {0, n >= 3 ? 1 : -1, n >= 3 ? 2 : -1, spec.alpha_channel};
  return c;
}

/// Colors that Rec. 709 does not have are cut off: a surface cannot reflect less than nothing.
void convert(const ColorSpace& space, float* rgb) {
  const Rgb c = space.to_linear({rgb[0], rgb[1], rgb[2]});
  rgb[0] = std::max(c.r, 0.0f), rgb[1] = std::max(c.g, 0.0f), rgb[2] = std::max(c.b, 0.0f);
}
bool is_usable(float v, bool negative_too) { return std::isfinite(v) && (v >= 0 || negative_too); }

OIIO::ImageSpec input_hints() {
  OIIO::ImageSpec hints;
  hints["oiio:UnassociatedAlpha"] = 1;  // color is not multiplied by alpha: opacity is applied by materials
  return hints;
}

/// Level 0 in memory.
class DecodedImage final : public Image {
 public:
  ~DecodedImage() override { image_bytes -= size_; }

  void reserve(int w, int h, TexelFormat f) {
    width = w, height = h, format = f;
    size_ = bytes_of(f) * w * h;
    image_bytes += size_;
    texels_.resize((size_ + 3) / 4);
    data = texels_.data();
  }
  void* texels() { return texels_.data(); }

  /// Level 0, decoded.
  Texel texel(int x, int y) const {
    const std::size_t i = std::size_t(y) * width + x;
    const auto* bytes = static_cast<const std::uint8_t*>(data);
    const auto* halves = static_cast<const std::uint16_t*>(data);
    const auto* floats = static_cast<const float*>(data);
    const auto& table = byte_table(srgb);
    const auto gray = [](float v) { return Texel{{v, v, v, 1}}; };
    switch (format) {
      case TexelFormat::kByte1:
        return gray(table[bytes[i]]);
      case TexelFormat::kByte4:
        return {{table[bytes[4 * i]], table[bytes[4 * i + 1]], table[bytes[4 * i + 2]], float(bytes[4 * i + 3]) / 255}};
      case TexelFormat::kHalf1:
        return gray(half_to_float(halves[i]));
      case TexelFormat::kHalf4:
        return {{half_to_float(halves[4 * i]), half_to_float(halves[4 * i + 1]), half_to_float(halves[4 * i + 2]),
                 half_to_float(halves[4 * i + 3])}};
      case TexelFormat::kFloat1:
        return gray(floats[i]);
      default:
        return {{floats[4 * i], floats[4 * i + 1], floats[4 * i + 2], floats[4 * i + 3]}};
    }
  }

  Texel mean() const override {
    std::call_once(mean_once_, [this] {
      double sum[4] = {};
      for (int y = 0; y < height; ++y) {
        float row[4] = {};
        for (int x = 0; x < width; ++x) {
          const Texel t = texel(x, y);
          for (int c = 0; c < 4; ++c) row[c] += t.c[c];
        }
        for (int c = 0; c < 4; ++c) sum[c] += double(row[c]);
      }
      for (int c = 0; c < 4; ++c) mean_.c[c] = float(sum[c] / (double(width) * height));
    });
    return mean_;
  }

  /// Halves the size until 1 x 1 by area-weighted means, so that odd sizes keep their mean too.
  void make_levels() {
    Grid<Texel> now(width, height);
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) now.at(x, y) = texel(x, y);
    while (now.size() > 1) {
      const int w = now.width(), h = now.height(), nw = std::max(w / 2, 1), nh = std::max(h / 2, 1);
      const double sx = double(w) / nw, sy = double(h) / nh;
      Grid<Texel> next(nw, nh);
      Level level{nw, nh, std::vector<std::uint16_t>(next.size() * 4)};
      for (int y = 0; y < nh; ++y)
        for (int x = 0; x < nw; ++x) {
          Texel sum;
          const double x0 = x * sx, x1 = x0 + sx, y0 = y * sy, y1 = y0 + sy;
          for (int j = int(y0); j < std::min(int(std::ceil(y1)), h); ++j)
            for (int i = int(x0); i < std::min(int(std::ceil(x1)), w); ++i) {
              const double area =
                  (std::min(x1, i + 1.0) - std::max(x0, double(i))) * (std::min(y1, j + 1.0) - std::max(y0, double(j)));
              sum = sum + now.at(i, j) * float(area / (sx * sy));
            }
          const std::size_t k = next.index(x, y);
          next[k] = sum;
          for (std::size_t c = 0; c < 4; ++c) level.texels[4 * k + c] = float_to_half(sum.c[c]);
        }
      levels.push_back(std::move(level));
      now = std::move(next);
    }
  }

 private:
  std::vector<std::uint32_t> texels_;  // words: aligned for every format
  std::size_t size_ = 0;
  mutable std::once_flag mean_once_;
  mutable Texel mean_;
};

/// The cache of tiles that all paged images share; it lives as long as one of them.
std::shared_ptr<OIIO::ImageCache> page_cache() {
  static std::mutex mutex;
  static std::weak_ptr<OIIO::ImageCache> shared;
  const std::lock_guard lock(mutex);
  if (auto cache = shared.lock()) return cache;
  std::shared_ptr<OIIO::ImageCache> cache(OIIO::ImageCache::create(false),
                                          [](OIIO::ImageCache* c) { OIIO::ImageCache::destroy(c); });
  cache->attribute("max_memory_MB", std::max(float(image_budget) / float(1 << 20), 10.0f));
  cache->attribute("autotile", 64);
  cache->attribute("automip", 1);
  cache->attribute("unassociatedalpha", 1);
  shared = cache;
  return cache;
}

/// Tiles of a file, read when they are needed.
class PagedImage final : public Image {
 public:
  PagedImage(const std::filesystem::path& file, const ColorSpace& space, bool mipmap, bool keep_negative)
      : cache_(page_cache()), space_(space), file_(file.string()), keep_negative_(keep_negative) {
    const OIIO::ustring name(file_);
    handle_ = cache_->get_image_handle(name);
    format = TexelFormat::kPaged;
    srgb = space.is_srgb();
    if (!handle_ || !cache_->get_imagespec(handle_, nullptr, spec_, 0, 0))
      throw Error(ErrorCode::kBadInput, cache_->geterror());
    width = spec_.width, height = spec_.height;
    channels_ = find_channels(spec_);
    int count = 1;
    if (mipmap) cache_->get_image_info(name, 0, 0, OIIO::ustring("miplevels"), OIIO::TypeInt, &count);
    for (int i = 0; i < count; ++i) {
      OIIO::ImageSpec s;
      if (!cache_->get_imagespec(handle_, nullptr, s, 0, i)) break;
      pages_.push_back(
          {s.width, s.height, s.tile_width ? s.tile_width : s.width, s.tile_height ? s.tile_height : s.height});
    }
    if (pages_.empty()) throw Error(ErrorCode::kBadInput, cache_->geterror());
  }

  void page_block(int level, int x, int y, int w, int h, Texel* out) const override {
    const Page& page = pages_[level];
    const int tx = x / page.tile_width, ty = y / page.tile_height;
    if ((x + w - 1) / page.tile_width != tx || (y + h - 1) / page.tile_height != ty) {  // across tiles: one by one
      for (int i = 0; i < w * h; ++i) page_block(level, x + i % w, y + i / w, 1, 1, out + i);
      return;
    }
    OIIO::ImageCache::Tile* tile = cache_->get_tile(handle_, nullptr, 0, level, spec_.x + x, spec_.y + y, 0);
    OIIO::TypeDesc type;
    const void* texels = tile ? cache_->tile_pixels(tile, type) : nullptr;
    for (int i = 0; i < w * h; ++i) {
      const std::size_t at = (y % page.tile_height + i / w) * page.tile_width + x % page.tile_width + i % w;
      // A file may break after its header was read: black then, as there is nobody to tell in a lookup.
      out[i] = texels ? decode(texels, type, at * spec_.nchannels) : Texel{};
    }
    if (tile)
      cache_->release_tile(tile);
    else
      cache_->geterror();
  }
  int page_levels() const override { return int(pages_.size()); }
  void page_size(int level, int& w, int& h) const override { w = pages_[level].width, h = pages_[level].height; }

  Texel mean() const override {
    std::call_once(mean_once_, [this] {
      const std::size_t n = spec_.nchannels;
      std::vector<float> row(n * width);
      double sum[4] = {};
      for (int y = 0; y < height; ++y) {
        if (!cache_->get_pixels(handle_, nullptr, 0, 0, spec_.x, spec_.x + width, spec_.y + y, spec_.y + y + 1, 0, 1, 0,
                                spec_.nchannels, OIIO::TypeFloat, row.data()))
          continue;
        for (int x = 0; x < width; ++x) {
          const Texel t = decode(row.data(), OIIO::TypeFloat, n * x);
          for (int c = 0; c < 4; ++c) sum[c] += double(t.c[c]);
        }
      }
      for (int c = 0; c < 4; ++c) mean_.c[c] = float(sum[c] / (double(width) * height));
    });
    return mean_;
  }

 private:
  struct Page {
    int width, height, tile_width, tile_height;
  };
  /// The texel whose channels begin at value `first` of `texels`.
  Texel decode(const void* texels, OIIO::TypeDesc type, std::size_t first) const {
    Texel t;
    for (std::size_t c = 0; c < 4; ++c) {
      int k = channels_.index[c];
      if (k < 0 && c == 3) {
        t.c[c] = 1;
        continue;
      }
      if (k < 0) k = channels_.index[0];
      const std::size_t at = first + k;
      const bool encoded = srgb && c < 3;
      if (type == OIIO::TypeUInt8) {
        t.c[c] = byte_table(encoded)[static_cast<const std::uint8_t*>(texels)[at]];
        continue;
      }
      float v = type == OIIO::TypeUInt16 ? float(static_cast<const std::uint16_t*>(texels)[at]) * (1.0f / 65535)
                : type == OIIO::TypeHalf ? half_to_float(static_cast<const std::uint16_t*>(texels)[at])
                                         : static_cast<const float*>(texels)[at];  // what the cache makes of all else
      if (!is_usable(v, keep_negative_)) {
        v = 0;
        // The whole file is never looked at, so that this is said when the first is met.
        if (!warned_.exchange(true)) log_warning(fmt::format("{}: {}", file_, kRepairedTexels));
      }
      t.c[c] = encoded ? srgb_to_linear(v) : v;
    }
    if (!srgb && !space_.is_linear()) convert(space_, t.c);
    return t;
  }
  std::shared_ptr<OIIO::ImageCache> cache_;
  ColorSpace space_;
  std::string file_;
  bool keep_negative_;
  mutable std::atomic<bool> warned_{false};
  OIIO::ImageCache::ImageHandle* handle_ = nullptr;
  OIIO::ImageSpec spec_;
  Channels channels_;
  std::vector<Page> pages_;
  mutable std::once_flag mean_once_;
  mutable Texel mean_;
};

/// File type of encoded bytes by their first bytes, as an extension; empty: unknown.
std::string_view sniff(std::string_view b) {
  const auto starts = [&](std::string_view s) { return b.substr(0, s.size()) == s; };
  if (starts("\x89PNG")) return "png";
  if (starts("\xFF\xD8\xFF")) return "jpg";
  if (starts("RIFF") && b.size() > 12 && b.substr(8, 4) == "WEBP") return "webp";
  if (starts("\x76\x2f\x31\x01")) return "exr";
  if (starts("#?RADIANCE") || starts("#?RGBE")) return "hdr";
  if (starts("BM")) return "bmp";
  if (starts("GIF8")) return "gif";
  if (starts(std::string_view("II*\0", 4)) || starts(std::string_view("MM\0*", 4))) return "tif";
  if (starts("\xABKTX 20\xBB")) return "ktx2";
  return {};
}

std::string clean(std::string message) {
  while (!message.empty() && (message.back() == '\n' || message.back() == ' ')) message.pop_back();
  std::replace(message.begin(), message.end(), '\n', ' ');
  return message.empty() ? "unknown format or damaged data" : message;
}

std::shared_ptr<const Image> read(const ImageRequest& request, const SourceLoc& loc) {
  const auto bad = [&](const std::string& why) {
    return Error(ErrorCode::kBadInput, loc, fmt::format("cannot read image \"{}\": {}", request.name, clean(why)));
  };
  const OIIO::ImageSpec hints = input_hints();
  OIIO::Filesystem::IOMemReader proxy(const_cast<char*>(request.encoded.data()), request.encoded.size());
  std::unique_ptr<OIIO::ImageInput> input;
  if (request.encoded.empty()) {
    std::error_code ec;
    if (!std::filesystem::is_regular_file(request.file, ec))
      throw Error(ErrorCode::kMissingFile, loc, fmt::format("image file \"{}\" does not exist", request.file.string()));
    input = OIIO::ImageInput::open(request.file.string(), &hints);
  } else {
    const std::string_view type = sniff(request.encoded);
    if (type.empty()) throw bad("neither PNG, JPEG, WebP, OpenEXR, Radiance, TIFF, BMP nor GIF");
    if (type == "ktx2")
      throw Error(ErrorCode::kUnsupported, loc,
                  fmt::format("image \"{}\" is a KTX2 texture; PNG, JPEG and WebP are supported", request.name));
    // OpenImageIO 2.4.7 forgets a proxy that is only passed to `open`; the hint reaches the reader.
    OIIO::ImageSpec from_memory = hints;
    OIIO::Filesystem::IOProxy* io = &proxy;
    from_memory.attribute("oiio:ioproxy", OIIO::TypeDesc::PTR, &io);
    input = OIIO::ImageInput::open(fmt::format("memory.{}", type), &from_memory);
  }
  if (!input) throw bad(OIIO::geterror());
  const OIIO::ImageSpec spec = input->spec();
  if (spec.width < 1 || spec.height < 1 || spec.nchannels < 1 || spec.deep) throw bad("it has no flat pixels");

  const Channels channels = find_channels(spec);
  ColorSpace space;
  if (request.auto_encoding) {
    space = color_space_of(*input, request.encoded.empty() ? request.file.string() : request.name);
  } else if (request.srgb) {
    space.transfer = ColorSpace::Transfer::kSrgb;
  }
  const bool srgb = space.is_srgb(), converts = !srgb && !space.is_linear();
  // What is converted when it is read needs finer steps than bytes have.
  const bool bytes_in_file = spec.format == OIIO::TypeDesc::UINT8 || spec.format == OIIO::TypeDesc::INT8;
  const bool is_byte = bytes_in_file && !converts;
  const bool is_half =
      spec.format == OIIO::TypeDesc::HALF || spec.format == OIIO::TypeDesc::UINT16 || (bytes_in_file && converts);
  const bool gray = channels.gray();
  const TexelFormat format = is_byte   ? (gray ? TexelFormat::kByte1 : TexelFormat::kByte4)
                             : is_half ? (gray ? TexelFormat::kHalf1 : TexelFormat::kHalf4)
                                       : (gray ? TexelFormat::kFloat1 : TexelFormat::kFloat4);
  const std::size_t count = spec.image_pixels();
  const std::size_t bytes = count * bytes_of(format) + (request.mipmap ? count * 8 / 3 : 0);
  if (image_bytes + bytes > image_budget && request.encoded.empty()) {
    input->close();
    try {
      return std::make_shared<PagedImage>(request.file, space, request.mipmap, request.keep_negative);
    } catch (const Error& e) {
      throw bad(e.message());
    }
  }
  constexpr std::size_t kMost = std::size_t(4) << 30;
  if (bytes > kMost)
    throw bad(
        fmt::format("{} x {} pixels inside another file are too many to decode at once", spec.width, spec.height));

  // Read row blocks in the file's channels and keep those that count: no second copy of the whole image.
  auto image = std::make_shared<DecodedImage>();
  image->srgb = srgb && is_byte;
  image->reserve(spec.width, spec.height, format);
  const std::size_t n = spec.nchannels, out = channels_of(format), row_values = n * spec.width;
  const int block = spec.tile_width ? spec.tile_height : int(std::clamp<std::size_t>((1 << 22) / row_values, 1, 64));
  std::vector<std::uint8_t> byte_row;
  std::vector<float> float_row;
  for (int y = 0; y < spec.height; y += block) {
    const int end = std::min(y + block, spec.height);
    const std::size_t values = row_values * (end - y);
    void* target;
    if (is_byte)
      byte_row.resize(values), target = byte_row.data();
    else
      float_row.resize(values), target = float_row.data();
    const OIIO::TypeDesc type = is_byte ? OIIO::TypeDesc::UINT8 : OIIO::TypeDesc::FLOAT;
    const bool ok = spec.tile_width
                        ? input->read_tiles(0, 0, spec.x, spec.x + spec.width, spec.y + y, spec.y + end, 0, 1, 0,
                                            spec.nchannels, type, target)
                        : input->read_scanlines(0, 0, spec.y + y, spec.y + end, 0, 0, spec.nchannels, type, target);
    if (!ok) throw bad(input->geterror());
    const std::size_t first = std::size_t(y) * spec.width;
    for (std::size_t i = 0; i < values / n; ++i) {
      float texel[4];
      for (std::size_t c = 0; c < 4; ++c) {
        const int from = channels.index[c] >= 0 ? channels.index[c] : c < 3 ? channels.index[0] : -1;
        if (!is_byte) {
          float v = from < 0 ? 1 : float_row[i * n + from];
          if (!is_usable(v, request.keep_negative)) v = 0, image->repaired = true;
          texel[c] = srgb && c < 3 ? srgb_to_linear(v) : v;
        } else if (c < out) {
          static_cast<std::uint8_t*>(image->texels())[(first + i) * out + c] = from < 0 ? 255 : byte_row[i * n + from];
        }
      }
      if (is_byte) continue;
      if (converts) convert(space, texel);
      for (std::size_t c = 0; c < out; ++c) {
        const std::size_t to = (first + i) * out + c;
        const float v = std::isfinite(texel[c]) ? texel[c] : 0.0f;
        if (is_half)
          static_cast<std::uint16_t*>(image->texels())[to] = float_to_half(v);
        else
          static_cast<float*>(image->texels())[to] = v;
      }
    }
  }
  if (request.mipmap) image->make_levels();
  return image;
}

}  // namespace

void set_image_memory_budget(std::size_t bytes) { image_budget = bytes; }

std::shared_ptr<const Image> load_image(const ImageRequest& request, const SourceLoc& loc) {
  static std::mutex mutex;  // a cache of what is alive anyway: it owns nothing and changes no result
  static std::map<std::string, std::weak_ptr<const Image>> images;
  std::error_code ec;
  std::string key =
      fmt::format("{}|{}|{}|{}|", request.auto_encoding, request.srgb, request.mipmap, request.keep_negative);
  if (request.encoded.empty()) {
    const auto time = std::filesystem::last_write_time(request.file, ec);
    key += fmt::format("{}|{}", std::filesystem::weakly_canonical(request.file, ec).string(),
                       ec ? 0 : time.time_since_epoch().count());
  } else {
    key +=
        fmt::format("{}|{}|{:x}", request.name, request.encoded.size(), std::hash<std::string_view>{}(request.encoded));
  }
  const std::lock_guard lock(mutex);
  if (auto image = images[key].lock()) return image;
  auto image = read(request, loc);
  images[key] = image;
  return image;
}

}  // namespace tempera
