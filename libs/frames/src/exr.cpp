// SPDX-License-Identifier: Apache-2.0
#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/half.h>
#include <OpenImageIO/imageio.h>
#include <fmt/format.h>

#include <algorithm>
#include <cstring>
#include <filesystem>
#include <map>
#include <set>

#include "tempera/core/parallel.h"
#include "tempera/frames/cryptomatte.h"
#include "tempera/frames/display.h"
#include "tempera/frames/files.h"
#include "tempera/frames/frame.h"

namespace tempera {
namespace {

constexpr const char* kLayersAttribute = "tempera/layers";
constexpr const char* kRolesAttribute = "tempera/layer_roles";
constexpr float kHalfMax = 65504;  ///< largest value of a 16-bit float
constexpr int kStrip = 128;  ///< scan lines that are packed or unpacked at once; a multiple of every EXR block height

std::string one_line(std::string text) {
  while (!text.empty() && std::isspace(static_cast<unsigned char>(text.back()))) text.pop_back();
  std::replace(text.begin(), text.end(), '\n', ' ');
  return text;
}

const char* oiio_name(Compression c) {
  switch (c) {
    case Compression::kNone:
      return "none";
    case Compression::kRle:
      return "rle";
    case Compression::kZips:
      return "zips";
    case Compression::kZip:
      return "zip";
    case Compression::kPiz:
      return "piz";
    case Compression::kDwaa:
      return "dwaa";
  }
  return "zip";
}

bool is_picture(const LayerDesc& d) { return d.unit == units::kRadiance || d.unit == units::kReflectance; }

/// Whether DWA would store a float channel of that name lossily: it decides by the last part of the name alone.
bool dwa_damages(const std::string& channel) {
  const auto dot = channel.rfind('.');
  std::string suffix = dot == std::string::npos ? channel : channel.substr(dot + 1);
  std::transform(suffix.begin(), suffix.end(), suffix.begin(), [](unsigned char c) { return char(std::tolower(c)); });
  static const std::set<std::string> lossy{"r", "red", "g", "grn", "green", "b", "blu", "blue", "y", "ry", "by"};
  return lossy.contains(suffix);
}

/// The descriptors of the layers as one attribute, for layers outside the vocabulary and for the order:
/// "name <tab> channels <tab> combine <tab> unit" a line.
std::string layers_text(const Frame& frame) {
  std::string text;
  for (const Layer& l : frame.layers()) {
    text += fmt::format("{}\t{}\t{}\t{}\n", l.desc.name, fmt::join(l.desc.channels, ","), to_string(l.desc.combine),
                        l.desc.unit);
  }
  return text;
}

/// Role, pass and path class of the layers of which the vocabulary says others or none: "name <tab> role <tab> pass
/// <tab> path class" a line. An attribute of its own, as readers of before it take no more fields in the other one.
std::string roles_text(const Frame& frame) {
  std::string text;
  for (const Layer& l : frame.layers()) {
    const LayerDesc& d = l.desc;
    const LayerDesc known = layers::find(d.name).value_or(LayerDesc{});
    if (d.role == known.role && d.pass == known.pass && d.path_class == known.path_class) continue;
    text += fmt::format("{}\t{}\t{}\t{}\n", d.name, to_string(d.role), d.pass, d.path_class);
  }
  return text;
}

std::vector<std::string> split(const std::string& text, char separator) {
  std::vector<std::string> parts;
  std::size_t begin = 0;
  for (;;) {
    const auto end = text.find(separator, begin);
    parts.push_back(text.substr(begin, end == std::string::npos ? end : end - begin));
    if (end == std::string::npos) return parts;
    begin = end + 1;
  }
}

/// `roles`: as roles_text makes it.
std::vector<LayerDesc> parse_layers_text(const std::string& text, const std::string& roles) {
  std::vector<LayerDesc> out;
  for (const std::string& line : split(text, '\n')) {
    const auto fields = split(line, '\t');
    if (fields.size() != 4) continue;
    LayerDesc d{fields[0], split(fields[1], ','), fields[3], Combine::kMean};
    for (const Combine c : {Combine::kSum, Combine::kFirst, Combine::kId, Combine::kVariance}) {
      if (fields[2] == to_string(c)) d.combine = c;
    }
    if (const auto known = layers::find(d.name)) {
      d.role = known->role, d.pass = known->pass, d.path_class = known->path_class, d.chain = known->chain;
    }
    out.push_back(std::move(d));
  }
  for (const std::string& line : split(roles, '\n')) {
    const auto fields = split(line, '\t');
    if (fields.size() != 4) continue;
    for (LayerDesc& d : out) {
      if (d.name != fields[0]) continue;
      for (const LayerRole r : {LayerRole::kFeature, LayerRole::kPicture, LayerRole::kStatistic,
                                LayerRole::kReconstruction, LayerRole::kMask}) {
        if (fields[1] == to_string(r)) d.role = r;
      }
      d.pass = fields[2], d.path_class = fields[3];
    }
  }
  return out;
}

/// The name that the cryptomatte of channel "<name>00.R" has, or "".
std::string crypto_set(const std::string& layer) {
  return layer.size() > 2 && layer.ends_with("00") ? layer.substr(0, layer.size() - 2) : "";
}
std::string layer_part(const std::string& channel) {
  const auto dot = channel.rfind('.');
  return dot == std::string::npos ? "" : channel.substr(0, dot);
}
}  // namespace

Compression parse_compression(std::string_view text) {
  for (const Compression c : {Compression::kNone, Compression::kRle, Compression::kZips, Compression::kZip,
                              Compression::kPiz, Compression::kDwaa}) {
    if (text == oiio_name(c)) return c;
  }
  throw Error(ErrorCode::kUnknownName,
              fmt::format("unknown EXR compression \"{}\"; known: zip, zips, piz, rle, none, dwaa", text));
}

std::string names_text(const WriteOptions& options) {
  return options.names == AovNames::kBlender ? "blender:" + options.view_layer : std::to_string(int(options.names));
}

void check_encoding(const std::vector<LayerDesc>& layers, const WriteOptions& options) {
  std::set<std::string> names;
  for (const AovChannel& c : aov_channels(layers, options.names, options.view_layer)) {
    if (!names.insert(c.name).second) {
      throw Error(ErrorCode::kBadInput, fmt::format("two layers would become the channel \"{}\"", c.name));
    }
    const auto layer = std::find_if(layers.begin(), layers.end(), [&](auto& d) { return d.name == c.source; });
    if (options.compression == Compression::kDwaa && !is_picture(*layer) && dwa_damages(c.name)) {
      throw Error(
          ErrorCode::kUnsupported,
          fmt::format("dwaa compression would damage layer \"{}\"; use zip, or leave that layer out", c.source));
    }
  }
}

void write_frame(const std::string& path, const Frame& frame, const WriteOptions& options) {
  if (frame.layers().empty() || frame.width() == 0 || frame.height() == 0) {
    throw Error(ErrorCode::kBadInput, fmt::format("cannot write {}: the frame has no layers", path));
  }
  std::vector<LayerDesc> descs;
  for (const Layer& l : frame.layers()) descs.push_back(l.desc);
  try {
    check_encoding(descs, options);
  } catch (const Error& e) {
    throw Error(e.code(), fmt::format("cannot write {}: {}", path, e.message()));
  }
  const std::vector<AovChannel> channels = aov_channels(descs, options.names, options.view_layer);

  struct Column {
    const Image* image;
    int channel;
    AovValue value;
    bool half;
  };
  std::vector<Column> columns;
  OIIO::ImageSpec spec(frame.width(), frame.height(), int(channels.size()), OIIO::TypeDesc::FLOAT);
  spec.channelnames.clear();
  Metadata metadata = frame.metadata;
  std::size_t pixel_bytes = 0;
  for (const AovChannel& c : channels) {
    const Layer& l = *frame.find(c.source);
    const bool half = options.half && is_picture(l.desc);
    columns.push_back({&l.image, c.source_channel, c.value, half});
    spec.channelnames.push_back(c.name);
    spec.channelformats.push_back(half ? OIIO::TypeDesc::HALF : OIIO::TypeDesc::FLOAT);
    pixel_bytes += half ? 2 : 4;
    if (c.source_channel == 0 && l.desc.combine == Combine::kId) {
      const std::string from = crypto_set(c.source), to = crypto_set(layer_part(c.name));
      if (!from.empty() && !to.empty()) rename_cryptomatte(metadata, from, to);
    }
  }
  spec.attribute("compression", oiio_name(options.compression));
  for (const auto& entry : metadata) {
    const std::string& name = entry.first;
    if (const double* number = std::get_if<double>(&entry.second)) {
      // The attributes that EXR defines are single floats; the library leaves those of another type out.
      if (!name.starts_with("tempera/") && double(float(*number)) == *number) {
        spec.attribute(name, float(*number));
      } else {
        spec.attribute(name, OIIO::TypeDesc::DOUBLE, number);
      }
    } else if (const int* integer = std::get_if<int>(&entry.second)) {
      spec.attribute(name, *integer);
    } else {
      spec.attribute(name, std::get<std::string>(entry.second));
    }
  }
  if (const auto fps = metadata.find("tempera/fps"); fps != metadata.end()) {  // the standard attribute, for players
    if (const double* v = std::get_if<double>(&fps->second); v && *v >= 0.001 && *v <= 1e6) {
      const FrameRate rate = frame_rate(*v);
      const int rational[2] = {rate.numerator, rate.denominator};
      spec.attribute("FramesPerSecond", OIIO::TypeRational, rational);
    }
  }
  if (const auto aspect = metadata.find(kPixelAspectKey); aspect != metadata.end()) {  // the standard one, for viewers
    if (const double* v = std::get_if<double>(&aspect->second); v && *v > 0) {
      spec.attribute("PixelAspectRatio", float(*v));
    }
  }
  // The library would add the time of day, and the same frame would not give the same file.
  if (!metadata.contains("DateTime")) spec.attribute("DateTime", "");
  if (options.names == AovNames::kTempera) {
    spec.attribute(kLayersAttribute, layers_text(frame));
    if (const std::string roles = roles_text(frame); !roles.empty()) spec.attribute(kRolesAttribute, roles);
  }
  if (options.names == AovNames::kBlender) spec.attribute("BlenderMultiChannel", "Blender V2.55.1 and newer");

  // The file is built in memory, so that every byte goes through write_file and its checks: streams inside the image
  // libraries buffer, and lose the error of a full disk when they are closed.
  OIIO::Filesystem::IOVecOutput memory;
  const auto out = OIIO::ImageOutput::create("frame.exr", &memory);
  const auto fail = [&](const std::string& reason) {
    return Error(ErrorCode::kFailed, fmt::format("cannot write {}: {}", path, one_line(reason)));
  };
  if (!out) throw fail(OIIO::geterror());
  if (!out->open("frame.exr", spec)) throw fail(out->geterror());
  const std::size_t row_bytes = pixel_bytes * frame.width();
  std::vector<std::byte> strip(row_bytes * std::min(kStrip, frame.height()));
  for (int y0 = 0; y0 < frame.height(); y0 += kStrip) {
    const int y1 = std::min(y0 + kStrip, frame.height());
    parallel_rows(
        y0, y1,
        [&](int y) {
          std::byte* to = strip.data() + row_bytes * (y - y0);
          for (int x = 0; x < frame.width(); ++x) {
            for (const Column& c : columns) {
              const float v = c.value.to_theirs(c.image->at(x, y, c.channel));
              if (c.half) {
                const half h(std::clamp(v, -kHalfMax, kHalfMax));
                std::memcpy(to, &h, 2);
                to += 2;
              } else {
                std::memcpy(to, &v, 4);
                to += 4;
              }
            }
          }
        },
        16);
    if (!out->write_scanlines(y0, y1, 0, OIIO::TypeDesc::UNKNOWN, strip.data())) throw fail(out->geterror());
  }
  if (!out->close()) throw fail(out->geterror());
  const auto& bytes = memory.buffer();
  write_file(path, std::as_bytes(std::span(bytes.data(), bytes.size())));
}

// ---------------------------------------------------------------------------------------------------------------------
// Reading.
namespace {

/// A channel of the file: which part holds it, and where in that part's pixels.
struct FileChannel {
  std::string name;
  int part = 0;
  int index = 0;
};

struct OpenFile {
  std::unique_ptr<OIIO::ImageInput> input;
  std::vector<OIIO::ImageSpec> parts;
  std::vector<FileChannel> channels;
  std::vector<LayerSource> layers;
  int x = 0, y = 0;
  FrameHeader header;
  bool srgb = false;  ///< integer pixels of a picture format
};

OIIO::TypeDesc channel_format(const OIIO::ImageSpec& spec, int c) {
  return spec.channelformats.empty() ? spec.format : spec.channelformats[c];
}

Metadata metadata_of(const OIIO::ImageSpec& spec) {
  // Attributes that describe the file rather than the frame.
  static const std::set<std::string> structural{"compression",
                                                "PixelAspectRatio",
                                                "screenWindowWidth",
                                                "screenWindowCenter",
                                                "name",
                                                "type",
                                                "BlenderMultiChannel",
                                                kLayersAttribute,
                                                kRolesAttribute,
                                                "dwaCompressionLevel",
                                                "CompressionQuality"};
  Metadata m;
  for (const auto& p : spec.extra_attribs) {
    const std::string name = p.name().string();
    if (structural.contains(name) || name.starts_with("openexr:") || name.starts_with("oiio:")) continue;
    if (p.type() == OIIO::TypeDesc::STRING) {
      if (name == "DateTime" && p.get_string().empty()) continue;  // see write_frame
      m[name] = p.get_string();
    } else if (p.type() == OIIO::TypeDesc::INT32) {
      m[name] = p.get_int();
    } else if (p.type() == OIIO::TypeDesc::FLOAT) {
      m[name] = double(p.get_float());
    } else if (p.type() == OIIO::TypeDesc::DOUBLE) {
      m[name] = *static_cast<const double*>(p.data());
    }
  }
  return m;
}

Error bad_file(const std::string& path, const std::string& reason) {
  return Error(ErrorCode::kBadInput, fmt::format("cannot read {}: {}", path, one_line(reason)));
}

bool is_main_part(std::string name) {
  std::transform(name.begin(), name.end(), name.begin(), [](unsigned char c) { return char(std::tolower(c)); });
  return name.empty() || name == "rgba" || name == "rgb" || name == "color" || name == "beauty" || name == "main" ||
         name == "combined";
}

OpenFile open_file(const std::string& path, const ReadOptions& options) {
  std::error_code ec;
  const auto status = std::filesystem::status(path, ec);
  if (!std::filesystem::exists(status)) {
    throw Error(ErrorCode::kMissingFile, fmt::format("cannot open {}: no such file", path));
  }
  if (std::filesystem::is_directory(status)) throw bad_file(path, "it is a directory");
  OpenFile f;
  f.input = OIIO::ImageInput::open(path);
  if (!f.input) throw bad_file(path, OIIO::geterror());
  const bool exr = std::strcmp(f.input->format_name(), "openexr") == 0;

  std::string first_view;
  std::vector<int> used;
  for (int part = 0; f.input->seek_subimage(part, 0); ++part) {
    const OIIO::ImageSpec spec = f.input->spec();
    if (spec.deep)
      throw Error(ErrorCode::kUnsupported, fmt::format("cannot read {}: deep images are not supported", path));
    const std::string view = spec.get_string_attribute("view");
    if (part == 0) first_view = view;
    if (part == 0 || (exr && view == first_view)) used.push_back(part);
    f.parts.push_back(spec);
    if (!exr) break;  // further pictures in a TIFF or GIF are not layers of the first
  }
  if (f.parts.empty()) throw bad_file(path, "it holds no image");
  f.input->geterror();  // of seeking past the last part

  const OIIO::ImageSpec& first = f.parts[0];
  f.x = first.full_x, f.y = first.full_y;
  f.header.width = first.full_width, f.header.height = first.full_height;
  if (f.header.width <= 0 || f.header.height <= 0) {
    f.x = first.x, f.y = first.y, f.header.width = first.width, f.header.height = first.height;
  }
  std::int64_t channel_count = 0;
  for (const int part : used) {
    const OIIO::ImageSpec& s = f.parts[part];
    channel_count += s.nchannels;
    const double values = double(s.width) * s.height * std::max(1, s.depth) * s.nchannels;
    if (s.width <= 0 || s.height <= 0 || s.nchannels <= 0) throw bad_file(path, "it holds no pixels");
    if (values > double(options.max_values))
      throw bad_file(path, fmt::format("{}x{} pixels are too many", s.width, s.height));
  }
  if (double(f.header.width) * f.header.height * double(channel_count) > double(options.max_values)) {
    throw bad_file(path, fmt::format("{}x{} pixels with {} channels are too many", f.header.width, f.header.height,
                                     channel_count));
  }

  bool main_part = false;
  for (const int part : used) {
    if (part > 0) main_part = main_part || is_main_part(f.parts[part].get_string_attribute("oiio:subimagename"));
  }
  std::set<std::string> seen;
  for (const int part : used) {
    const OIIO::ImageSpec& s = f.parts[part];
    const std::string part_name = s.get_string_attribute("oiio:subimagename");
    const bool plain = used.size() == 1 || is_main_part(part_name) || (part == 0 && !main_part);
    for (int c = 0; c < s.nchannels; ++c) {
      std::string name = s.channelnames[c];
      if (!plain && name.find('.') == std::string::npos) name = part_name + "." + name;
      if (!seen.insert(name).second) {
        name = fmt::format("{}.{}", part_name.empty() ? fmt::format("part{}", part) : part_name, name);
        if (!seen.insert(name).second) continue;
      }
      f.channels.push_back({name, part, c});
    }
  }
  std::vector<std::string> names;
  for (const FileChannel& c : f.channels) names.push_back(c.name);
  f.layers = layers_of_channels(names, options.rename);
  f.header.metadata = metadata_of(first);
  f.srgb = options.decode && !exr && (first.format == OIIO::TypeDesc::UINT8 || first.format == OIIO::TypeDesc::UINT16);
  if (!exr) {
    for (LayerSource& l : f.layers) {
      if (l.desc.name == "color") l.desc.unit = units::kRadiance;
    }
  }

  // Our own descriptors, where the file has them, say what the names cannot.
  std::vector<LayerDesc> stored =
      parse_layers_text(first.get_string_attribute(kLayersAttribute), first.get_string_attribute(kRolesAttribute));
  std::vector<LayerSource> ordered;
  for (const LayerDesc& d : stored) {
    for (LayerSource& l : f.layers) {
      if (l.desc.name != d.name || l.channels.size() != d.channels.size()) continue;
      LayerSource s{d, {}};
      for (const std::string& channel : d.channels) {
        const auto it = std::find(l.desc.channels.begin(), l.desc.channels.end(), channel);
        if (it != l.desc.channels.end()) s.channels.push_back(l.channels[it - l.desc.channels.begin()]);
      }
      if (s.channels.size() != d.channels.size()) continue;
      ordered.push_back(std::move(s));
      l.channels.clear();
      break;
    }
  }
  for (LayerSource& l : f.layers) {
    if (!l.channels.empty()) ordered.push_back(std::move(l));
  }
  f.layers = std::move(ordered);

  for (const LayerSource& l : f.layers) {
    const std::string to = crypto_set(l.desc.name);
    const std::string from = crypto_set(layer_part(f.channels[l.channels[0].channel].name));
    if (!to.empty() && !from.empty()) rename_cryptomatte(f.header.metadata, from, to);
  }
  if (!options.layers.empty()) {
    std::vector<LayerSource> wanted;
    for (const std::string& name : options.layers) {
      const auto it = std::find_if(f.layers.begin(), f.layers.end(), [&](auto& l) { return l.desc.name == name; });
      if (it == f.layers.end()) {
        std::vector<std::string> have;
        for (const LayerSource& l : f.layers) have.push_back(l.desc.name);
        throw Error(ErrorCode::kUnknownName,
                    fmt::format("{} has no layer \"{}\"; it has {}", path, name, nearest_names(name, have, 64)));
      }
      wanted.push_back(*it);
    }
    f.layers = std::move(wanted);
  }
  for (const LayerSource& l : f.layers) f.header.layers.push_back(l.desc);
  return f;
}

/// A value in the file's format as float; only 8- and 16-bit pictures are scaled to [0,1], identifiers stay integers.
float to_float(const std::byte* p, OIIO::TypeDesc format) {
  switch (format.basetype) {
    case OIIO::TypeDesc::FLOAT: {
      float v;
      std::memcpy(&v, p, 4);
      return v;
    }
    case OIIO::TypeDesc::HALF: {
      half v;
      std::memcpy(&v, p, 2);
      return v;
    }
    case OIIO::TypeDesc::UINT32: {
      std::uint32_t v;
      std::memcpy(&v, p, 4);
      return float(v);
    }
    case OIIO::TypeDesc::INT32: {
      std::int32_t v;
      std::memcpy(&v, p, 4);
      return float(v);
    }
    case OIIO::TypeDesc::UINT16: {
      std::uint16_t v;
      std::memcpy(&v, p, 2);
      return float(v) / 65535.0f;
    }
    case OIIO::TypeDesc::UINT8:
      return float(std::to_integer<std::uint8_t>(*p)) / 255.0f;
    case OIIO::TypeDesc::DOUBLE: {
      double v;
      std::memcpy(&v, p, 8);
      return float(v);
    }
    default:
      return 0;
  }
}

/// A channel of a layer, filled from channel `offset` bytes into the pixels of a part.
struct Target {
  Image* image;
  int channel;
  std::size_t offset;
  OIIO::TypeDesc format;
  AovValue value;
  bool srgb;
};

void unpack(const OpenFile& f, const OIIO::ImageSpec& spec, const std::vector<Target>& targets, const std::byte* data,
            int y0, int y1) {
  const std::size_t pixel_bytes = spec.pixel_bytes(true), row_bytes = pixel_bytes * spec.width;
  const int xa = std::max(spec.x, f.x), xb = std::min(spec.x + spec.width, f.x + f.header.width);
  const int ya = std::max(y0, f.y), yb = std::min(y1, f.y + f.header.height);
  if (xa >= xb || ya >= yb) return;
  parallel_rows(
      ya, yb,
      [&](int y) {
        const std::byte* row = data + row_bytes * (y - y0);
        for (const Target& t : targets) {
          const std::byte* from = row + pixel_bytes * (xa - spec.x) + t.offset;
          for (int x = xa; x < xb; ++x, from += pixel_bytes) {
            const float v = to_float(from, t.format);
            t.image->at(x - f.x, y - f.y, t.channel) = t.srgb ? srgb_to_linear(v) : t.value.to_ours(v);
          }
        }
      },
      16);
}
}  // namespace

Frame read_frame(const std::string& path, const ReadOptions& options) {
  OpenFile f = open_file(path, options);
  Frame frame(f.header.width, f.header.height);
  frame.metadata = std::move(f.header.metadata);
  std::map<int, std::vector<Target>> targets;  // by part
  try {
    for (const LayerSource& l : f.layers) {
      Image& image = frame.create(l.desc);
      for (int c = 0; c < std::ssize(l.channels); ++c) {
        const FileChannel& from = f.channels[l.channels[c].channel];
        const OIIO::ImageSpec& spec = f.parts[from.part];
        std::size_t offset = 0;
        for (int i = 0; i < from.index; ++i) offset += channel_format(spec, i).size();
        targets[from.part].push_back(
            {&image, c, offset, channel_format(spec, from.index), l.channels[c].value, f.srgb && from.name != "A"});
      }
    }
    for (const auto& [part, list] : targets) {
      const OIIO::ImageSpec& spec = f.parts[part];
      const std::size_t row_bytes = spec.pixel_bytes(true) * spec.width;
      const bool whole = spec.tile_width > 0;  // tiles do not come in strips
      const int step = whole ? spec.height : kStrip;
      std::vector<std::byte> data(row_bytes * std::min(step, spec.height));
      for (int y0 = spec.y; y0 < spec.y + spec.height; y0 += step) {
        const int y1 = std::min(y0 + step, spec.y + spec.height);
        const bool ok = whole ? f.input->read_image(part, 0, 0, spec.nchannels, OIIO::TypeDesc::UNKNOWN, data.data())
                              : f.input->read_scanlines(part, 0, y0, y1, 0, 0, spec.nchannels, OIIO::TypeDesc::UNKNOWN,
                                                        data.data());
        if (!ok) throw bad_file(path, f.input->geterror());
        unpack(f, spec, list, data.data(), y0, y1);
      }
    }
  } catch (const std::bad_alloc&) {
    throw Error(ErrorCode::kOutOfMemory, fmt::format("not enough memory to read {}", path));
  }
  return frame;
}

FrameHeader read_header(const std::string& path, const ReadOptions& options) { return open_file(path, options).header; }
Metadata read_metadata(const std::string& path) { return open_file(path, {}).header.metadata; }

std::string content_identity(const std::string& path) {
  const Metadata metadata = read_metadata(path);
  for (const auto& [key, value] : metadata) {
    const auto* text = is_fingerprint_key(key) ? std::get_if<std::string>(&value) : nullptr;
    // Two stages without parameters may come to the same fingerprint for the same input.
    if (text) return key == kFingerprintKey ? *text : fmt::format("{} {}", key, *text);
  }
  std::error_code ignored;
  const auto time = std::filesystem::last_write_time(path, ignored).time_since_epoch().count();
  return fmt::format("{}:{}", std::filesystem::file_size(path, ignored), time);
}

}  // namespace tempera
