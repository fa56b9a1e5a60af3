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
      if (!i.params.empty()) out += fmt::format("\nParameters of `{}`:\n\n{}", i.name, params_table(i.params));
    }
  }
  return out;
}

/// The rule of output_pattern and settle_output.
constexpr const char* kOutputNames = R"(
## Names of output frames

`output.path`, `reconstruct.path` and every `-o` for frames (of `render`, `run`, `reconstruct` and `gallery run`) follow one rule:

| written | files |
| --- | --- |
| `out/f.####.exr` | `out/f.0001.exr`, `out/f.0002.exr`, ... |
| `out/f.exr` | for one frame `out/f.exr`; for several `out/f.0001.exr`, ... |
| `out/f.####` | `.exr` is added |
| `out`, `out/`, a folder that exists | `out/NAME.0001.exr`, ...: NAME is that of the shot, or of the frames that are reconstructed |
| `out/f.####.png`, `f.tif`, ... | refused with the name that would do: frames are OpenEXR |

The place for the number is a run of `#` or `@` as long as the number, `%d` or `%04d`, `$F` or `$F4`, or `<frame>`, `<F>` or `<F4>`; input
(`compare`, `video`, `reconstruct`) takes the same. Where shot.toml names the output of several frames as one file, `--frames 5` still
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
                       t.depth == 2 ? "`type` and its parameters" : t.key_name, cell(t.help));
  }
  out +=
      "\n## Materials\n\nA table `[materials.<name>]` replaces the material of that name in the scene. Colors are a "
      "number, "
      "three numbers (linear Rec. 709), `\"#rrggbb\"` (sRGB) or an image file.\n";
  for (const MaterialEntry& m : material_catalog()) {
    out += fmt::format("\n`type = \"{}\"`: {}.\n\n{}", m.name, m.help, params_table(m.params));
  }
  out += "\nAll types:\n\n" + params_table({common_material_params().begin(), common_material_params().end()});
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
