// SPDX-License-Identifier: Apache-2.0
#include "builder.h"

#include <fmt/format.h>

#include <cmath>

#include "tempera/core/error.h"

namespace tempera {

using namespace gallery;

GalleryBuilder::GalleryBuilder(const GalleryScene& scene, const GalleryOptions& options)
    : scene_(scene), options_(options), glb_(std::make_unique<Glb>()) {
  // Motion vectors look one frame beyond the shot, and exposures may do so, too.
  keys(0, scene.last_frame + 2, 4);
}

void GalleryBuilder::start_file(const std::string& name) {
  files_[glb_file_] = glb_->bytes();
  glb_ = std::make_unique<Glb>();
  glb_file_ = name;
}

int GalleryBuilder::texture(const std::string& name, const Picture& picture, bool srgb) {
  files_[name + ".png"] = encode_png(picture, srgb);
  return glb_->image(name + ".png");
}

int GalleryBuilder::material(const Look& look, const std::string& exact) {
  materials_[look.name] = exact;
  return glb_->material(look);
}

int GalleryBuilder::glass(const std::string& name, double ior) {
  Look look{.name = name, .color = Rgb(1.0f), .roughness = 0, .transmission = 1, .ior = ior};
  return material(look, fmt::format("type = \"dielectric\"\nint_ior = {}\next_ior = 1.0\n", ior));
}

void GalleryBuilder::environment(const Picture& picture) {
  files_["environment.exr"] = encode_exr(picture);
  environment_ = {{"image", "\"environment.exr\""}};
}
void GalleryBuilder::environment(const Rgb& c) {
  environment_ = {{"radiance", fmt::format("[{}, {}, {}]", c.r, c.g, c.b)}};
}

void GalleryBuilder::exposure(double stops) { video_ = {{"exposure", fmt::format("{:.1f}", stops)}}; }

void GalleryBuilder::scene_file(const std::string& name, const std::string& text) {
  scene_file_ = name;
  files_[name] = text;
}

std::filesystem::path GalleryBuilder::needed_file() const {
  const std::filesystem::path file = std::filesystem::absolute(options_.scenes / scene_.needs).lexically_normal();
  std::error_code ignored;
  if (std::filesystem::is_regular_file(file, ignored)) return file;
  throw Error(ErrorCode::kMissingFile,
              fmt::format("the gallery's \"{}\" moves through a published scene that is not part of Tempera, {}; it is "
                          "looked for in \"{}\". Name the folder that holds it with --scenes FOLDER or in the "
                          "environment variable TEMPERA_SCENES",
                          scene_.name, scene_.needs, options_.scenes.string()));
}

int GalleryBuilder::mesh(const std::string& name, const Polygons& polygons, int material) {
  const Glb::Part part{polygons, material};
  return glb_->mesh(name, {&part, 1});
}

int GalleryBuilder::place(const std::string& name, const Polygons& polygons, int material, const Vec3d& position,
                          const Quatd& rotation, int parent) {
  return place(name, mesh(name, polygons, material), position, rotation, parent);
}
int GalleryBuilder::place(const std::string& name, int mesh, const Vec3d& position, const Quatd& rotation, int parent) {
  return glb_->node({.name = name, .parent = parent, .translation = position, .rotation = rotation, .mesh = mesh});
}
int GalleryBuilder::lamp(const std::string& name, const Vec2d& size, const Rgb& radiance, const Vec3d& position,
                         const Vec3d& direction) {
  const int bright = material({.name = name, .color = Rgb(0.0f), .specular = 0, .emission = radiance});
  const int black = material({.name = name + "_back", .color = Rgb(0.0f), .specular = 0});
  Polygons back;
  back.add(floor_plane(size * 1.02), at({0, -0.001, 0}));
  const Glb::Part parts[] = {{floor_plane(size), bright}, {back, black}};
  // The panel is made facing +y. Its first side stays level.
  const Vec3d y = normalize(direction);
  const Vec3d x = normalize(std::abs(y.y) > 0.9 ? cross(y, Vec3d{0, 0, 1}) : cross(Vec3d{0, 1, 0}, y));
  return glb_->node({.name = name,
                     .translation = position,
                     .rotation = quaternion(Affine3d{x, y, cross(x, y)}),
                     .mesh = glb_->mesh(name, parts)});
}
int GalleryBuilder::group(const std::string& name, const Vec3d& position, const Quatd& rotation, int parent) {
  return glb_->node({.name = name, .parent = parent, .translation = position, .rotation = rotation});
}

void GalleryBuilder::keys(double begin, double end, int per_frame) {
  frames_.clear(), seconds_.clear();
  const int count = int(std::lround((end - begin) * per_frame));
  for (int i = 0; i <= count; ++i) {
    frames_.push_back(begin + double(i) / per_frame);
    seconds_.push_back(frames_.back() / scene_.fps);
  }
}

void GalleryBuilder::move(int node, const std::function<Vec3d(double)>& position) {
  std::vector<Vec3d> values;
  for (const double f : frames_) values.push_back(position(f));
  glb_->translate(node, seconds_, values);
}
void GalleryBuilder::morph(int node, const std::function<std::vector<double>(double)>& weights) {
  std::vector<double> values;
  for (const double f : frames_) {
    const std::vector<double> w = weights(f);
    values.insert(values.end(), w.begin(), w.end());
  }
  glb_->morph(node, seconds_, values);
}
void GalleryBuilder::turn(int node, const std::function<Quatd(double)>& rotation) {
  std::vector<Quatd> values;
  for (const double f : frames_) values.push_back(rotation(f));
  glb_->rotate(node, seconds_, values);
}

void GalleryBuilder::camera(double fov, const Vec3d& eye, const Vec3d& target) {
  const int camera = glb_->camera("camera", fov, double(scene_.width) / scene_.height);
  glb_->node({.name = "camera", .translation = eye, .rotation = view(eye, target), .camera = camera});
}
void GalleryBuilder::camera_above(const std::string& name, const Vec3d& eye, const Vec2d& size) {
  const int camera = glb_->camera(name, size);
  glb_->node({.name = name, .translation = eye, .rotation = gallery::about_x(-90), .camera = camera});
}
void GalleryBuilder::camera(double fov, const std::function<Vec3d(double)>& eye,
                            const std::function<Vec3d(double)>& target) {
  const int camera = glb_->camera("camera", fov, double(scene_.width) / scene_.height);
  const int node = glb_->node({.name = "camera", .camera = camera});
  move(node, eye);
  turn(node, [&](double f) { return view(eye(f), target(f)); });
}

std::string GalleryBuilder::shot_text(const GalleryVariant* variant) const {
  const GalleryScene& s = scene_;
  // Keys of a variant replace those of the scene; a key without a dot stands above the tables.
  std::map<std::string, std::string> own;
  if (variant) own.insert(variant->keys.begin(), variant->keys.end());
  const auto line = [&](const std::string& table, const std::string& key, const std::string& value) {
    const std::string dotted = table.empty() ? key : table + "." + key;
    const auto it = own.find(dotted);
    std::string text = fmt::format("{} = {}\n", key, it == own.end() ? value : it->second);
    if (it != own.end()) {
      if (it->second.empty()) text.clear();  // a variant without this key
      own.erase(it);
    }
    return text;
  };
  const auto rest = [&](const std::string& table) {  // keys that only the variant has
    std::string text;
    for (auto it = own.begin(); it != own.end();) {
      const auto dot = it->first.rfind('.');
      const bool here = dot == std::string::npos ? table.empty() : it->first.substr(0, dot) == table;
      if (here)
        text += fmt::format("{} = {}\n", dot == std::string::npos ? it->first : it->first.substr(dot + 1), it->second);
      it = here ? own.erase(it) : std::next(it);
    }
    return text;
  };

  std::string out = fmt::format("# {}: {}.\n", s.name, s.title);
  if (variant) out += fmt::format("# Variant \"{}\": {}.\n", variant->name, variant->help);
  out += fmt::format("# Made by `tempera gallery make {}`; change a copy, or give flags to `tempera gallery run`.\n",
                     s.name);
  out += line("", "scene", fmt::format("\"{}\"", scene_file_));
  out += line("", "camera", "\"camera\"");
  out += line("", "frames", fmt::format("\"{}\"", s.frames()));
  out += line("", "fps", fmt::format("{}", s.fps));
  out += rest("");
  // One table with the keys that the scene gives and those that only the variant has.
  const auto table = [&](const std::string& name, const std::vector<std::pair<std::string, std::string>>& keys) {
    std::string lines;
    for (const auto& [key, value] : keys) lines += line(name, key, value);
    lines += rest(name);
    if (!lines.empty()) out += fmt::format("\n[{}]\n{}", name, lines);
  };
  table("shutter", {{"open", fmt::format("{}", s.shutter_open)}, {"close", fmt::format("{}", s.shutter_close)}});
  table("film", {{"resolution", fmt::format("[{}, {}]", s.width, s.height)}, {"filter", "\"box\""}});
  std::vector<std::pair<std::string, std::string>> sampling{{"spp", fmt::format("{}", s.spp)}};
  if (s.independent_samples) sampling.emplace_back("sampler", "\"independent\"");
  table("sampling", sampling);
  table("integrator", {{"name", "\"path\""}, {"max_depth", fmt::format("{}", s.max_depth)}});
  table("output", {{"layers", "[\"albedo\", \"normal\", \"motion\"]"}});
  table("video", video_);
  table("environment", environment_);
  table("cameras.camera", {});
  if (!s.classes.empty()) {
    out += s.decomposition ? "\n[decompose]\n" : "\n[classes]\n";
    for (const GalleryClass& c : s.classes) out += fmt::format("{} = \"{}\"  # {}\n", c.name, c.expression, c.help);
  }
  for (const auto& [name, lines] : materials_) {
    out += fmt::format("\n[materials.{}]\n", name);
    for (std::size_t at = 0; at < lines.size();) {
      const std::size_t end = lines.find('\n', at), equals = lines.find(" = ", at);
      out += line("materials." + name, lines.substr(at, equals - at), lines.substr(equals + 3, end - equals - 3));
      at = end + 1;
    }
  }
  TEMPERA_ASSERT(own.empty());  // else the variant changes what is not there
  return out;
}

std::string GalleryBuilder::readme() const {
  const GalleryScene& s = scene_;
  std::string out = fmt::format("# {}\n\n{}.\n", s.name, s.title);
  if (s.paper) out += fmt::format("Stands for {}: {}.\n", s.stands_for(), s.paper->title);
  out += "\n" + s.about;
  if (out.back() != '\n') out += '\n';
  out += "\n## Numbers\n\n| | |\n| --- | --- |\n";
  out += fmt::format("| frames | {} at {} per second, shutter {} to {} of a frame |\n", s.frames(), s.fps,
                     s.shutter_open, s.shutter_close);
  out += fmt::format("| picture | {} x {}, {} samples per pixel, paths of at most {} edges |\n", s.width, s.height,
                     s.spp, s.max_depth);
  out += fmt::format("| triangles | {} |\n", s.triangles);
  std::string moving = fmt::format("{}", fmt::join(s.moving, ", "));
  if (s.camera_moves) moving = moving.empty() ? "the camera" : moving + ", and the camera";
  out += fmt::format("| in motion | {} |\n", moving);
  if (!s.needs.empty())
    out += fmt::format("| needs | `{}`, in the folder that `--scenes` or `TEMPERA_SCENES` names |\n", s.needs);
  out += fmt::format("| reference | {} samples per pixel: `tempera gallery reference {}` |\n", s.reference_spp, s.name);
  if (!s.classes.empty()) {
    out += fmt::format("\n## Light-path classes\n\n{}\n\n| class | expression | |\n| --- | --- | --- |\n",
                       s.decomposition ? "Parts of the picture; with `class.residual.color` they add up to it."
                                       : "Layers `class.<name>.color`.");
    for (const GalleryClass& c : s.classes) {
      std::string expression;
      for (const char letter : c.expression) {
        if (letter == '|') expression += '\\';  // a bare one would end the table's cell
        expression += letter;
      }
      out += fmt::format("| `{}` | `{}` | {} |\n", c.name, expression, c.help);
    }
  }
  if (!s.variants.empty()) {
    out += "\n## Variants\n\n| | |\n| --- | --- |\n";
    for (const GalleryVariant& v : s.variants) out += fmt::format("| `{}:{}` | {} |\n", s.name, v.name, v.help);
  }
  out += fmt::format(
      "\n## Use\n\n```sh\ntempera gallery run {0}                 # render it\ntempera gallery run {0} --frames {1} "
      "--spp 16 "
      "--resolution-scale 50\ntempera gallery reference {0}           # the converged frames; continues where it was "
      "stopped\n```\n",
      s.name, s.first_frame);
  return out;
}

GalleryFiles GalleryBuilder::finish() {
  if (scene_file_ == "scene.glb") files_[glb_file_] = glb_->bytes();
  files_["shot.toml"] = shot_text(nullptr);
  for (const GalleryVariant& v : scene_.variants) files_["shot_" + v.name + ".toml"] = shot_text(&v);
  files_["README.md"] = readme();
  return std::move(files_);
}

namespace gallery {

Quatd view(const Vec3d& eye, const Vec3d& target) {
  const Vec3d z = normalize(eye - target), x = normalize(cross(Vec3d{0, 1, 0}, z));
  return quaternion(Affine3d{x, cross(z, x), z});
}
Quatd about_x(double degrees) { return axis_angle(Vec3d{1, 0, 0}, degrees * kPiD / 180); }
Quatd about_y(double degrees) { return axis_angle(Vec3d{0, 1, 0}, degrees * kPiD / 180); }
Quatd about_z(double degrees) { return axis_angle(Vec3d{0, 0, 1}, degrees * kPiD / 180); }

}  // namespace gallery
}  // namespace tempera
