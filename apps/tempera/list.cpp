// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <cstdio>
#include <nlohmann/json.hpp>

#include "catalog.h"
#include "program.h"
#include "tempera/frames/layers.h"
#include "tempera/import/import.h"
#include "tempera/methods/method.h"
#include "tempera/pipeline/materials.h"
#include "tempera/stages/stage.h"

namespace tempera {

namespace {

std::vector<CatalogItem> integrators() {
  std::vector<CatalogItem> out;
  for (const MethodEntry* e : method_catalog()) out.push_back({e->name, e->help, {e->params.begin(), e->params.end()}});
  return out;
}

std::vector<CatalogItem> layer_items() {
  std::vector<CatalogItem> out;
  const auto add = [&](const LayerDesc& d, const std::string& name) {
    out.push_back(
        {name, fmt::format("{}: {}; merged by {}", fmt::join(d.channels, ","), d.unit, to_string(d.combine)), {}});
  };
  for (const LayerDesc& d : layers::known()) add(d, d.name);
  add(layers::class_layer("name", layers::color()), "class.<name>.color");
  for (const std::vector<LayerDesc>* list : {&layers::chain_features(), &layers::chain_motion()}) {
    for (const LayerDesc& d : *list) add(layers::chain_layer("RD", d), "chain.<letters>." + d.name);
  }
  add(layers::crypto(0), "CryptoObject00");
  out.push_back({"motion", "short for motion.forward and motion.backward", {}});
  out.push_back({"halves", "short for color.a and color.b", {}});
  out.push_back({"chain.any.<feature>", "that feature of all chains together, up to six events", {}});
  out.push_back({"chain.<letters>", "short for all features of a chain", {}});
  const std::string common = fmt::format("{}", fmt::join(layers::kCommonChains, ", "));
  out.push_back({"chains", "short for all features of the chains " + common, {}});
  if (!layers::chain_motion().empty()) {
    out.push_back(
        {"chain.<letters>.motion", "short for motion.forward, motion.backward and motion.state of a chain", {}});
    out.push_back({"chain_motion", "short for those of the chains " + common + ", without D", {}});
  }
  out.push_back({"cryptomatte", "short for CryptoObject00 to CryptoObject02", {}});
  return out;
}

std::vector<CatalogItem> stages() {
  std::vector<CatalogItem> out;
  for (const StageEntry* e : stage_catalog()) {
    CatalogItem& item = out.emplace_back(CatalogItem{e->name, e->help, e->params});
    for (const StagePort& p : e->ports) item.manual.emplace_back("port " + p.name, p.help);
    const auto layers = [&](const char* what, const std::vector<LayerHelp>& rows) {
      for (const LayerHelp& h : rows) {
        item.manual.emplace_back(what, fmt::format("{}: {}", fmt::join(h.layers, ", "), h.help));
      }
    };
    layers("reads", e->reads);
    layers("writes", e->writes);
    item.manual.emplace_back("frames that it reads to make one", e->window);
    if (!e->inserted_help.empty()) item.manual.emplace_back("in a run", e->inserted_help);
    if (e->follows) item.manual.emplace_back("follows by itself after", e->follows_help);
  }
  return out;
}

std::vector<CatalogItem> filters() {
  std::vector<CatalogItem> out;
  for (const FilterKind k : {FilterKind::kBox, FilterKind::kTent, FilterKind::kGaussian, FilterKind::kMitchell,
                             FilterKind::kBlackmanHarris}) {
    out.push_back({filter_name(k), fmt::format("usual radius {:g} pixels", PixelFilter(k).radius()), {}});
  }
  return out;
}

std::vector<CatalogItem> samplers() {
  return {{"sobol", "Owen-scrambled Sobol points: less noise at the same cost", {}},
          {"independent", "independent random numbers", {}}};
}

std::vector<CatalogItem> importer_items() {
  std::vector<CatalogItem> out;
  for (const ImporterEntry* e : importers()) {
    out.push_back({std::string(e->name), fmt::format("{} ({})", e->help, fmt::join(e->extensions, ", ")), {}});
  }
  return out;
}

std::vector<CatalogItem> bsdfs() {
  std::vector<CatalogItem> out;
  for (const MaterialEntry* e : material_catalog()) out.push_back({e->name, e->help, e->params});
  out.push_back(
      {"(all)", "parameters that every type has", {common_material_params().begin(), common_material_params().end()}});
  return out;
}

}  // namespace

const std::vector<CatalogCategory>& catalog() {
  static const std::vector<CatalogCategory> categories = {
      {"integrators", "methods that estimate light transport", integrators},
      {"layers", "what frames can hold", layer_items},
      {"filters", "pixel filters", filters},
      {"samplers", "random numbers", samplers},
      {"stages", "what can follow a render", stages},
      {"importers", "scene formats", importer_items},
      {"bsdfs", "materials that a shot can give", bsdfs},
      {"metrics", "what compare measures", metric_items},
  };
  return categories;
}

std::string type_text(const ParamSpec& spec) {
  if (!spec.choices.empty()) return fmt::format("{}", fmt::join(spec.choices, "|"));
  std::string type = type_name(spec.fallback);
  if (type != "integer" && type != "number") return type;
  constexpr double kOpen = 1e300;
  if (spec.min > -kOpen && spec.max < kOpen) return fmt::format("{}, {:g} to {:g}", type, spec.min, spec.max);
  if (spec.min > -kOpen) return fmt::format("{}, at least {:g}", type, spec.min);
  if (spec.max < kOpen) return fmt::format("{}, at most {:g}", type, spec.max);
  return type;
}

void add_list(Program& program) {
  struct Flags {
    std::string category;
    bool json = false;
  };
  auto flags = std::make_shared<Flags>();
  std::vector<std::string> names;
  for (const CatalogCategory& c : catalog()) names.push_back(c.name);
  CLI::App* command = program.add(
      "list", "Show what there is to choose from, with parameters.",
      {"tempera list integrators", "tempera list layers", "tempera list bsdfs --json"}, [flags, names] {
        nlohmann::ordered_json json = nlohmann::ordered_json::object();
        bool found = flags->category.empty();
        for (const CatalogCategory& c : catalog()) {
          if (!flags->category.empty() && flags->category != c.name) continue;
          found = true;
          const std::vector<CatalogItem> items = c.items();
          nlohmann::ordered_json list = nlohmann::ordered_json::array();
          if (!flags->json && flags->category.empty()) std::printf("%s: %s\n", c.name.c_str(), c.help.c_str());
          if (!flags->json && items.empty()) std::printf("  (none in this version)\n");
          for (const CatalogItem& i : items) {
            nlohmann::ordered_json params = nlohmann::ordered_json::array();
            if (!flags->json) std::printf("  %-20s %s\n", i.name.c_str(), i.help.c_str());
            nlohmann::ordered_json manual = nlohmann::ordered_json::array();
            for (const auto& [what, text] : i.manual) {
              manual.push_back({{"what", what}, {"text", text}});
              if (flags->json || flags->category.empty()) continue;
              std::printf("    %s: %s\n", what.c_str(), text.c_str());
            }
            for (const ParamSpec& p : i.params) {
              params.push_back(
                  {{"name", p.name}, {"type", type_text(p)}, {"default", to_text(p.fallback)}, {"help", p.help}});
              if (flags->json || flags->category.empty()) continue;
              std::printf("    %-22s %s [%s] (%s)\n", p.name.c_str(), p.help.c_str(), to_text(p.fallback).c_str(),
                          type_text(p).c_str());
            }
            nlohmann::ordered_json item{{"name", i.name}, {"help", i.help}};
            if (!params.empty()) item["parameters"] = params;
            if (!manual.empty()) item["manual"] = manual;
            list.push_back(std::move(item));
          }
          json[c.name] = list;
        }
        if (!found) {
          throw Error(ErrorCode::kUnknownName, ShotConfig::kCommandLine(),
                      fmt::format("nothing is called \"{}\"; known: {}", flags->category,
                                  nearest_names(flags->category, names)));
        }
        if (flags->json) std::printf("%s\n", json.dump(2).c_str());
        return 0;
      });
  command
      ->add_option("category", flags->category, fmt::format("{}; all of them if none is named", fmt::join(names, ", ")))
      ->type_name("CATEGORY");
  command->add_flag("--json", flags->json, "as JSON");
}

}  // namespace tempera
