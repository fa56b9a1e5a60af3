// SPDX-License-Identifier: Apache-2.0
#pragma once
// From the XML of Mitsuba's files to a Document. The frame of it, files, objects and references, is in mitsuba_xml.cpp;
// elements that hold values and the steps of transforms are in mitsuba_elements.cpp, and each is a line of a table.
#include <fmt/format.h>

#include <filesystem>
#include <initializer_list>
#include <map>
#include <memory>
#include <pugixml.hpp>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "mitsuba_xml.h"
#include "named.h"

namespace tempera::mitsuba {

class Parser {
 public:
  Parser(Document& document, const std::vector<std::pair<std::string, std::string>>& defines, InputFiles& inputs,
         Warnings& warnings)
      : document_(document), inputs_(inputs), warnings_(warnings) {
    for (const auto& [name, value] : defines) parameters_[name] = {value, true, false};
  }

  std::shared_ptr<Object> parse_file(const std::filesystem::path& path, const SourceLoc& from);

  void finish() {
    for (const auto& [name, parameter] : parameters_)
      if (parameter.is_define && !parameter.used)
        warnings_.add(
            fmt::format("the parameter \"{}\" that was defined on the command line is not used by the scene", name),
            {"<command line>"});
    for (const auto& [id, place] : document_.referenced_)
      if (!document_.ids_.contains(id)) fail_unknown_id(id, place);
  }
  [[noreturn]] void fail_unknown_id(const std::string& id, const Place& place) const {
    std::vector<std::string> known;
    for (const auto& [name, object] : document_.ids_) known.push_back(name);
    const std::string nearest = nearest_names(id, known);
    throw Error(ErrorCode::kUnknownName, document_.loc(place),
                fmt::format("there is no object with the id \"{}\"; {}", id,
                            nearest.empty() ? "the scene has no ids" : "known: " + nearest));
  }

 private:
  struct Parameter {
    std::string value;
    bool is_define = false;
    bool used = false;
  };
  using Attributes = std::map<std::string, std::pair<std::string, Place>, std::less<>>;  // name -> value, its place

  [[noreturn]] void fail(ErrorCode code, const Place& place, const std::string& message) const {
    throw Error(code, document_.loc(place), message);
  }
  Place place(const pugi::xml_node& node) const {
    const std::ptrdiff_t offset = node.offset_debug();  // of the name, behind the '<'
    return {file_, offset > 0 ? std::size_t(offset) - 1 : 0};
  }
  Attributes attributes(const pugi::xml_node& node, std::initializer_list<std::string_view> required,
                        std::initializer_list<std::string_view> optional);
  std::string substitute(std::string_view text, const Place& place);
  void parse_children(const pugi::xml_node& node, Object& parent, int depth);
  void parse_child(const pugi::xml_node& node, Object& parent, int depth);
  void parse_object(const pugi::xml_node& node, Object& parent, int depth);
  void include(const pugi::xml_node& node, Object& parent);
  void add(Object& parent, std::string_view name, Value value, const Place& place);

  double number(const std::pair<std::string, Place>& text, std::string_view what) const;
  Vec3d vector3(const Attributes& a, double missing, const Place& place) const;
  Vec3d vector3(const std::pair<std::string, Place>& text, std::string_view what) const;
  Spectrum spectrum(const std::pair<std::string, Place>& text) const;
  Spectrum spectrum_file(const std::string& name, const Place& place);
  Affine3d transform(const pugi::xml_node& node);
  void transform_step(const pugi::xml_node& node, Affine3d& map);

  // Steps of transforms.
  Affine3d translate_step(const pugi::xml_node& node);
  Affine3d scale_step(const pugi::xml_node& node);
  Affine3d rotate_step(const pugi::xml_node& node);
  Affine3d look_at_step(const pugi::xml_node& node);
  Affine3d matrix_step(const pugi::xml_node& node);
  static constexpr Named<Affine3d (Parser::*)(const pugi::xml_node&)> kSteps[] = {
      {"translate", &Parser::translate_step}, {"rotate", &Parser::rotate_step},  {"scale", &Parser::scale_step},
      {"lookat", &Parser::look_at_step},      {"lookAt", &Parser::look_at_step}, {"matrix", &Parser::matrix_step}};

  // Elements that are no objects.
  void parse_transform(const pugi::xml_node& node, Object& parent);
  void parse_animation(const pugi::xml_node& node, Object& parent);
  void parse_float(const pugi::xml_node& node, Object& parent);
  void parse_integer(const pugi::xml_node& node, Object& parent);
  void parse_boolean(const pugi::xml_node& node, Object& parent);
  void parse_string(const pugi::xml_node& node, Object& parent);
  void parse_vector(const pugi::xml_node& node, Object& parent);
  void parse_color(const pugi::xml_node& node, Object& parent);
  void parse_spectrum(const pugi::xml_node& node, Object& parent);
  void parse_blackbody(const pugi::xml_node& node, Object& parent);
  void parse_reference(const pugi::xml_node& node, Object& parent);
  void parse_alias(const pugi::xml_node& node, Object& parent);
  void parse_default(const pugi::xml_node& node, Object& parent);
  void parse_path(const pugi::xml_node& node, Object& parent);
  struct Element {
    void (Parser::*parse)(const pugi::xml_node&, Object& parent);
    bool has_children;
  };
  static constexpr Named<Element> kElements[] = {
      {"boolean", {&Parser::parse_boolean}},
      {"integer", {&Parser::parse_integer}},
      {"float", {&Parser::parse_float}},
      {"string", {&Parser::parse_string}},
      {"point", {&Parser::parse_vector}},
      {"vector", {&Parser::parse_vector}},
      {"rgb", {&Parser::parse_color}},
      {"srgb", {&Parser::parse_color}},
      {"spectrum", {&Parser::parse_spectrum}},
      {"blackbody", {&Parser::parse_blackbody}},
      {"transform", {&Parser::parse_transform, true}},
      {"animation", {&Parser::parse_animation, true}},
      {"ref", {&Parser::parse_reference}},
      {"alias", {&Parser::parse_alias}},
      {"include", {&Parser::include}},
      {"default", {&Parser::parse_default}},
      {"path", {&Parser::parse_path}},
  };

  Document& document_;
  InputFiles& inputs_;
  Warnings& warnings_;
  std::map<std::string, Parameter, std::less<>> parameters_;
  std::vector<std::filesystem::path> include_stack_;
  int include_count_ = 0;
  int file_ = 0;                  // the file that is being parsed
  const char* buffer_ = nullptr;  // its text, for the places of attributes
  std::size_t buffer_size_ = 0;
};

}  // namespace tempera::mitsuba
