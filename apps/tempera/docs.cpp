// SPDX-License-Identifier: Apache-2.0
// The pages of the manual that are made from the program's own tables. tests/cli checks that the committed ones are
// current.
#include <fmt/format.h>

#include <cstdio>

#include "catalog.h"
#include "program.h"
#include "tempera/frames/files.h"
#include "tempera/gallery/gallery.h"
#include "tempera/pipeline/materials.h"
#include "tempera/pipeline/scene_edits.h"

namespace tempera {

namespace {

constexpr const char* kNotice = "<!-- Made by `tempera docs`. Change the tables in the code instead. -->\n";

/// Text in a cell of a table.
std::string cell(std::string text) {
  for (std::size_t at = 0; (at = text.find('|', at)) != std::string::npos; at += 2) text.replace(at, 1, "\\|");
  return text;
}

std::string value_cell(const std::string& text) { return text.empty() ? "" : "`" + cell(text) + "`"; }

std::string params_table(const std::vector<ParamSpec>& params) {
  std::string out = "| parameter | type | default | meaning |\n| --- | --- | --- | --- |\n";
  for (const ParamSpec& p : params) {
    out += fmt::format("| `{}` | {} | {} | {} |\n", p.name, cell(type_text(p)), value_cell(to_text(p.fallback)),
                       cell(p.help));
  }
  return out;
}

/// The page of --help for a command whose parents are `parents`. `App::help` would show that of the command that runs.
std::string help_text(const CLI::App& app, const std::string& parents) {
  const std::string name = parents.empty() ? app.get_name() : parents + " " + app.get_name();
  return app.get_formatter()->make_help(&app, name, CLI::AppFormatMode::Normal);
}

std::string commands_page(const CLI::App& app) {
  std::string out = fmt::format("{}\n# Commands\n\n```text\n{}```\n", kNotice, help_text(app, ""));
  for (const CLI::App* command : app.get_subcommands(nullptr)) {
    if (command->get_group().empty()) continue;
    const std::string name = "tempera " + command->get_name();
    out += fmt::format("\n## {}\n\n```text\n{}```\n", name, help_text(*command, "tempera"));
    for (const CLI::App* nested : command->get_subcommands(nullptr))
      out += fmt::format("\n### {} {}\n\n```text\n{}```\n", name, nested->get_name(), help_text(*nested, name));
  }
  out += "\n## What there is to choose from\n\nAs `tempera list` shows it.\n";
  for (const CatalogCategory& c : catalog()) {
    const std::vector<CatalogItem> items = c.items();
    if (items.empty() || c.name == "bsdfs") continue;  // shot.md has the materials
    out += fmt::format("\n### {}\n\n| name | meaning |\n| --- | --- |\n", c.name);
    for (const CatalogItem& i : items) out += fmt::format("| `{}` | {} |\n", i.name, cell(i.help));
    for (const CatalogItem& i : items) {
      if (i.manual.empty()) continue;
      out += fmt::format("\n`{}` in short:\n\n| | |\n| --- | --- |\n", i.name);
      for (const auto& [what, text] : i.manual) out += fmt::format("| {} | {} |\n", what, cell(text));
    }
    for (const CatalogItem& i : items) {
      if (!i.params.empty()) out += fmt::format("\nParameters of `{}`:\n\n{}", i.name, params_table(i.params));
    }
  }
  return out;
}

/// The rule of output_pattern and settle_output.
constexpr const char* kOutputNames = R"(
## Names of output frames

`output.path`, the `path` of each stage, and every `-o` for frames (of `render`, `run`, `gallery run` and the commands of stages) follow one
rule:

| written | files |
| --- | --- |
| `out/f.####.exr` | `out/f.0001.exr`, `out/f.0002.exr`, ... |
| `out/f.exr` | for one frame `out/f.exr`; for several `out/f.0001.exr`, ... |
| `out/f.####` | `.exr` is added |
| `out`, `out/`, a folder that exists | `out/NAME.0001.exr`, ...: NAME is that of the shot, or of the frames that a stage reads |
| `out/f.####.png`, `f.tif`, ... | refused with the name that would do: frames are OpenEXR |

The place for the number is a run of `#` or `@` as long as the number, `%d` or `%04d`, `$F` or `$F4`, or `<frame>`, `<F>` or `<F4>`; input
(`compare`, `video`, stages) takes the same. Where shot.toml names the output of several frames as one file, `--frames 5` still
writes `f.0005.exr`, so that parts of a shot never replace each other; given with `-o` on the command line, `f.exr` is that one frame.
Missing folders are made.
)";

std::string shot_page() {
  std::string out = fmt::format(
      "{}\n# shot.toml\n\n"
      "A shot names a scene and says how to render a sequence of it. Every key can be given on the command line, too: "
      "by its flag, or by `--set KEY=VALUE` with what a line of shot.toml would have (`--set film.crop='[0, 0, 64, "
      "48]'`, "
      "`--set 'film={{scale=50, filter=\"tent\"}}'`); text and lists of numbers may do without quotes and brackets "
      "(`--set film.crop=0,0,64,48`). Each value comes from the command line, else from shot.toml, else from the scene "
      "file, else it is the default below. Unknown keys are errors. Input files are relative to the folder of "
      "shot.toml.\n\n"
      "```toml\n"
      "scene = \"robot.glb\"\n"
      "frames = \"1-48\"\n"
      "fps = 24\n"
      "first_frame = 1\n\n"
      "[film]\nresolution = [1280, 720]\nfilter = \"blackman_harris\"\n\n"
      "[sampling]\nspp = 128\n\n"
      "[integrator]\nname = \"path\"\nmax_depth = 8\n\n"
      "[output]\npath = \"out/robot.####.exr\"\nlayers = [\"albedo\", \"normal\", \"motion\"]\n\n"
      "[decompose]\ndirect = \"ED\"\nindirect = \"ED.+\"\n\n"
      "[materials.Glass]\ntype = \"dielectric\"\nint_ior = 1.52\n"
      "```\n",
      kNotice);
  std::string section = "?";
  for (const ShotKey& k : shot_keys()) {
    const auto dot = k.spec.name.find('.');
    const std::string table = dot == std::string::npos ? "" : k.spec.name.substr(0, dot);
    if (table != section) {
      section = table;
      out += table.empty() ? "\n## Keys outside of tables\n\n" : fmt::format("\n## [{}]\n\n", table);
      out += "| key | type | default | flag | meaning |\n| --- | --- | --- | --- | --- |\n";
    }
    const std::string fallback = !k.fallback_help.empty() ? k.fallback_help : value_cell(to_text(k.spec.fallback));
    out += fmt::format(
        "| `{}` | {} | {} | {} | {} |\n", dot == std::string::npos ? k.spec.name : k.spec.name.substr(dot + 1),
        cell(k.list ? "list or text" : type_text(k.spec)), cell(fallback), value_cell(k.flag), cell(k.spec.help));
  }
  out += kOutputNames;
  out += "\n## Tables with names of your own\n\n| table | keys | meaning |\n| --- | --- | --- |\n";
  for (const OpenTable& t : shot_tables()) {
    out += fmt::format("| `[{}]` | {} | {} |\n", t.depth == 2 ? t.name + ".<" + t.key_name + ">" : t.name,
                       t.name == "materials" ? "`type` and its parameters"
                       : t.depth == 2        ? "parameters, see below"
                                             : t.key_name,
                       cell(t.help));
  }
  out +=
      "\n## Materials\n\nA table `[materials.<name>]` replaces the material of that name in the scene. Colors are a "
      "number, "
      "three numbers (linear Rec. 709), `\"#rrggbb\"` (sRGB) or an image file.\n";
  for (const MaterialEntry* m : material_catalog()) {
    out += fmt::format("\n`type = \"{}\"`: {}.\n\n{}", m->name, m->help, params_table(m->params));
  }
  out += "\nAll types:\n\n" + params_table({common_material_params().begin(), common_material_params().end()});
  const auto table = [](std::span<const ParamSpec> specs) { return params_table({specs.begin(), specs.end()}); };
  out +=
      "\n## Cameras\n\n`[camera]` changes the camera that renders, `[cameras.<name>]` the one of that name. Lengths, "
      "angles and shifts are those of Blender's camera: with `sensor_fit = \"auto\"` the sensor's width lies along the "
      "larger side of the picture, pixel aspect included; a shift is a fraction of that side and moves the window, x "
      "to "
      "the right and y up, so that what it shows moves the other way. What is at distance d along the view axis while "
      "`focus_distance` is f spreads over a circle of confusion whose diameter is focal length^2 / f_stop x |d - f| / "
      "(d (f - focal length)) on the sensor of a thin lens; here, as in Blender, the sensor is where the field of view "
      "says, so f - focal length becomes f. An orthographic camera has no focal length: its lens has a radius of "
      "1 / (2 f_stop) meters. `focus_object` names an object or node; it may move, and so may the camera. Frames with "
      "a `pixel_aspect` hold it as the EXR attribute `pixelAspectRatio`, and motion vectors count in those pixels.\n\n"
      "```toml\n[camera]\nname = \"Shot cam\"\nf_stop = 2.8\nfocus_distance = [[1, 2.5], [24, 4]]   # at frames, "
      "linear in between\nshift_y = 0.1\n```\n";
  out +=
      "\n## Lights\n\nA table `[lights.<name>]` changes the light of that name in the scene, by the name of the light "
      "or "
      "of its object, or an object that emits. Parameters that do not apply to it are errors.\n\n" +
      table(light_params()) +
      "\nA point or spot with a `radius` becomes an emitting sphere: it is matter, so it casts shadows in the light of "
      "others, and mirrors show it; the camera looks through it unless `camera_visible` says otherwise. A spot keeps "
      "its "
      "cone by direction. Its radiance is intensity / (pi radius^2). A sun with an `angle` has the radiance irradiance "
      "/ "
      "(pi sin^2(angle / 2)), so that a surface facing its middle gets the same irradiance. `spread` multiplies "
      "radiance "
      "by (tan(s) - tan(a)) / (tan(s) - s), where s is half of the spread and a the angle to the normal: the power "
      "stays. `blend` is Blender's: smoothstep of the cosine over the fraction `blend` of 1 - cos(cone / 2).\n";
  out +=
      "\n## Vertex caches\n\nA table `[caches.<name>]` moves the vertices of an object, or of a mesh, by a file of "
      "positions; [formats.md](formats.md#vertex-caches) says how to write one.\n\n" +
      table(cache_params());
  return out;
}

}  // namespace

void add_docs(Program& program) {
  auto folder = std::make_shared<std::string>("docs");
  CLI::App* command =
      program.add("docs", "Write the pages of the manual that are made from tables.", {}, [&program, folder] {
        write_file(*folder + "/commands.md", commands_page(program.app));
        write_file(*folder + "/shot.md", shot_page());
        write_file(*folder + "/gallery.md", fmt::format("{}\n{}", kNotice, gallery_page()));
        return 0;
      });
  command->group("");  // for the project itself: not shown in --help
  command->add_option("--out", *folder, "folder to write to [docs]")->type_name("FOLDER");
}

}  // namespace tempera
