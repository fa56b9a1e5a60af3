// SPDX-License-Identifier: Apache-2.0
#include "mitsuba_xml.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>

#include "mitsuba_parser.h"
#include "tempera/import/paths.h"

namespace tempera::mitsuba {

// Bounds on what a hostile file can ask for. Real scenes stay far below them.
constexpr int kMaxDepth = 64;  // nested elements
constexpr int kMaxIncludeDepth = 32;
constexpr int kMaxIncludes = 10000;             // files that include each other twice grow exponentially
constexpr std::size_t kMaxAttribute = 1 << 24;  // bytes after substitution; likewise for parameters in parameters

namespace {

constexpr std::array<std::string_view, 14> kObjectTags{"scene",   "integrator", "sensor",  "film",      "sampler",
                                                       "rfilter", "bsdf",       "emitter", "shape",     "texture",
                                                       "medium",  "phase",      "volume",  "subsurface"};

template <class Range>
bool contains(const Range& range, std::string_view name) {
  return std::find(std::begin(range), std::end(range), name) != std::end(range);
}

}  // namespace

std::string Object::name() const { return plugin.empty() ? tag : fmt::format("{} \"{}\"", tag, plugin); }

std::shared_ptr<Object> Parser::parse_file(const std::filesystem::path& path, const SourceLoc& from) {
  const FileContents contents = inputs_.read(path, from);
  std::string text(contents.view());
  Document::File file{path, {0}, false};
  for (std::size_t i = 0; i < text.size(); ++i)
    if (text[i] == '\n') file.line_starts.push_back(i + 1);
  document_.files_.push_back(std::move(file));

  const int saved_file = std::exchange(file_, int(document_.files_.size()) - 1);
  const char* const saved_buffer = std::exchange(buffer_, text.data());
  const std::size_t saved_size = std::exchange(buffer_size_, text.size());
  include_stack_.push_back(std::filesystem::weakly_canonical(path));

  pugi::xml_document xml;
  const pugi::xml_parse_result parsed = xml.load_buffer_inplace(text.data(), text.size());
  if (parsed.status == pugi::status_out_of_memory) throw std::bad_alloc();
  if (!parsed)
    fail(ErrorCode::kSyntax, {file_, std::size_t(std::max<std::ptrdiff_t>(parsed.offset, 0))},
         fmt::format("this is not well-formed XML: {}", parsed.description()));
  const pugi::xml_node root = xml.document_element();
  if (!contains(kObjectTags, root.name()))
    fail(ErrorCode::kBadInput, place(root),
         fmt::format("the root element <{}> is no Mitsuba scene; expected <scene version=\"3.0.0\">", root.name()));
  if (!root.attribute("version"))
    fail(ErrorCode::kBadInput, place(root),
         fmt::format("the root element <{}> lacks its version, e.g. version=\"3.0.0\"", root.name()));
  double major = 0;
  const std::string_view version = root.attribute("version").value();
  if (!parse_number(version.substr(0, version.find('.')), major))
    fail(ErrorCode::kBadInput, place(root),
         fmt::format("cannot read the version \"{}\"; expected e.g. 3.0.0", version));
  document_.files_.back().legacy = major < 2;

  auto holder = std::make_shared<Object>();
  holder->place = place(root);
  parse_object(root, *holder, 0);

  include_stack_.pop_back();
  file_ = saved_file;
  buffer_ = saved_buffer;
  buffer_size_ = saved_size;
  return holder;
}

std::string Parser::substitute(std::string_view text, const Place& place) {
  if (text.find('$') == std::string_view::npos) return std::string(text);
  std::string result;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] == '\\' && i + 1 < text.size() && text[i + 1] == '$') {  // an escaped dollar sign
      result += text[++i];
      continue;
    }
    if (text[i] != '$') {
      result += text[i];
      continue;
    }
    // The longest known name wins: "$sppx" means "$spp" followed by "x" if only "spp" exists, as in Mitsuba.
    std::size_t end = i + 1;
    while (end < text.size() && (std::isalnum(static_cast<unsigned char>(text[end])) || text[end] == '_')) ++end;
    auto found = parameters_.end();
    std::size_t used = end;
    for (; used > i + 1 && found == parameters_.end(); --used) {
      found = parameters_.find(text.substr(i + 1, used - i - 1));
      if (found != parameters_.end()) break;
    }
    if (found == parameters_.end()) {
      std::vector<std::string> known;
      for (const auto& [name, parameter] : parameters_) known.push_back(name);
      fail(ErrorCode::kUnknownName, place,
           fmt::format("the parameter \"${}\" has no value; give it a <default> or define it on the command line{}",
                       text.substr(i + 1, end - i - 1), known.empty() ? "" : "; known: " + nearest_names("", known)));
    }
    found->second.used = true;
    result += found->second.value;
    if (result.size() > kMaxAttribute) fail(ErrorCode::kBadInput, place, "parameters expand without end");
    i = used - 1;
  }
  return result;
}

Parser::Attributes Parser::attributes(const pugi::xml_node& node, std::initializer_list<std::string_view> required,
                                      std::initializer_list<std::string_view> optional) {
  Attributes result;
  for (const pugi::xml_attribute& a : node.attributes()) {
    Place at = place(node);
    const std::ptrdiff_t offset = a.value() - buffer_;  // values are decoded in place, so that they still start here
    if (offset > 0 && offset < std::ptrdiff_t(buffer_size_)) at.offset = offset;
    if (!contains(required, a.name()) && !contains(optional, a.name())) {
      std::string known;
      for (const auto& list : {required, optional})
        for (std::string_view n : list) known += (known.empty() ? "" : ", ") + std::string(n);
      fail(ErrorCode::kUnknownName, at,
           fmt::format("<{}> has no attribute \"{}\"; known: {}", node.name(), a.name(), known));
    }
    result[a.name()] = {substitute(a.value(), at), at};
  }
  for (std::string_view name : required)
    if (!result.contains(name))
      fail(ErrorCode::kBadInput, place(node), fmt::format("<{}> lacks its attribute \"{}\"", node.name(), name));
  return result;
}

void Parser::add(Object& parent, std::string_view name, Value value, const Place& place) {
  std::string key = snake_case(name);
  if (!key.empty())
    for (const Property& p : parent.properties)
      if (p.name == key)
        fail(ErrorCode::kBadInput, place,
             fmt::format("{} has its parameter \"{}\" twice, here and at {}", parent.name(), key,
                         document_.loc(p.place).str()));
  parent.properties.push_back({std::move(key), std::move(value), place});
}

void Parser::include(const pugi::xml_node& node, Object& parent) {
  const Place at = place(node);
  const Attributes a = attributes(node, {"filename"}, {"name"});
  const auto& name = a.at("filename");
  if (std::ssize(include_stack_) >= kMaxIncludeDepth || ++include_count_ > kMaxIncludes)
    fail(ErrorCode::kBadInput, at,
         fmt::format("too many includes; at most {} inside each other and {} in all", kMaxIncludeDepth, kMaxIncludes));
  const std::filesystem::path path = document_.find_file(name.first, at);
  inputs_.check(path, document_.loc(name.second));
  const std::filesystem::path real = std::filesystem::weakly_canonical(path);
  if (std::find(include_stack_.begin(), include_stack_.end(), real) != include_stack_.end())
    fail(ErrorCode::kBadInput, name.second, fmt::format("\"{}\" includes itself", name.first));
  const std::shared_ptr<Object> holder = parse_file(path, document_.loc(name.second));
  // The parts of an included <scene> become parts of this object; any other root element is one part itself.
  const auto& root = std::get<ObjectPtr>(holder->properties.front().value);
  if (root->tag == "scene") {
    for (const Property& p : root->properties) parent.properties.push_back(p);
  } else {
    parent.properties.push_back({a.contains("name") ? snake_case(a.at("name").first) : "", root, at});
  }
}

void Parser::parse_object(const pugi::xml_node& node, Object& parent, int depth) {
  const bool is_root = depth == 0;
  const bool is_scene = node.name() == std::string_view("scene");
  const Attributes a = is_root    ? attributes(node, {"version"}, {"type", "id", "name"})
                       : is_scene ? attributes(node, {}, {"type", "id", "name"})
                                  : attributes(node, {"type"}, {"id", "name"});
  auto object = std::make_shared<Object>();
  object->tag = node.name();
  object->place = place(node);
  if (const auto type = a.find("type"); type != a.end()) object->plugin = type->second.first;
  if (const auto id = a.find("id"); id != a.end() && !id->second.first.empty()) {
    object->id = id->second.first;
    const auto [other, added] = document_.ids_.try_emplace(object->id, object);
    if (!added)
      fail(ErrorCode::kBadInput, id->second.second,
           fmt::format("the id \"{}\" is taken already, at {}", object->id, document_.loc(other->second->place).str()));
  }
  const auto name = a.find("name");
  add(parent, name == a.end() ? "" : name->second.first, ObjectPtr(object), object->place);
  parse_children(node, *object, depth);
}

void Parser::parse_children(const pugi::xml_node& node, Object& parent, int depth) {
  for (const pugi::xml_node& child : node.children())
    if (child.type() == pugi::node_element) parse_child(child, parent, depth + 1);
}

void Parser::parse_child(const pugi::xml_node& node, Object& parent, int depth) {
  const std::string_view tag = node.name();
  const Place at = place(node);
  if (depth > kMaxDepth)
    fail(ErrorCode::kBadInput, at, fmt::format("elements are nested more than {} deep", kMaxDepth));
  if (contains(kObjectTags, tag) || (tag == "spectrum" && node.attribute("type")))
    return parse_object(node, parent, depth);

  const auto* element = find_named(kElements, tag);
  if (!element || !element->value.has_children) {
    for (const pugi::xml_node& child : node.children())
      if (child.type() == pugi::node_element)
        fail(ErrorCode::kBadInput, place(child), fmt::format("<{}> cannot stand inside <{}>", child.name(), tag));
  }
  if (element) return (this->*element->value.parse)(node, parent);
  if (find_named(kSteps, tag))
    fail(ErrorCode::kUnknownName, at, fmt::format("<{}> can only stand inside <transform>", tag));
  std::vector<std::string> known(kObjectTags.begin(), kObjectTags.end());
  for (const auto& e : kElements) known.emplace_back(e.name);
  fail(ErrorCode::kUnknownName, at, fmt::format("unknown element <{}>; known: {}", tag, nearest_names(tag, known)));
}

// ---------------------------------------------------------------------------------------------------------------------

Document::Document(const std::filesystem::path& file, const std::vector<std::pair<std::string, std::string>>& defines,
                   InputFiles& inputs, Warnings& warnings) {
  folders_.push_back(file.parent_path());
  Parser parser(*this, defines, inputs, warnings);
  const std::shared_ptr<Object> holder = parser.parse_file(file, {file.string()});
  scene_ = std::get<ObjectPtr>(holder->properties.front().value);
  if (scene_->tag != "scene")
    throw Error(ErrorCode::kBadInput, loc(scene_->place),
                fmt::format("the root element is <{}>; a scene that can be rendered starts with <scene>", scene_->tag));
  parser.finish();
}

const Object& Document::resolve(const Property& property) const {
  if (const auto* reference = std::get_if<Reference>(&property.value)) return *ids_.find(reference->id)->second;
  return *std::get<ObjectPtr>(property.value);
}

SourceLoc Document::loc(const Place& place) const {
  const File& file = files_[place.file];
  const auto line = std::upper_bound(file.line_starts.begin(), file.line_starts.end(), place.offset) - 1;
  return {file.path.string(), int(line - file.line_starts.begin()) + 1, int(place.offset - *line) + 1};
}

std::filesystem::path Document::find_file(const std::string& name, const Place& place) const {
  std::error_code failed;
  for (const std::filesystem::path& folder : folders_)
    if (std::filesystem::path file = named_file(folder, name); std::filesystem::exists(file, failed)) return file;
  // Parts that were included may also count from their own folder.
  std::filesystem::path sibling = named_file(files_[place.file].path.parent_path(), name);
  return std::filesystem::exists(sibling, failed) ? sibling : named_file(folders_.back(), name);
}

}  // namespace tempera::mitsuba
