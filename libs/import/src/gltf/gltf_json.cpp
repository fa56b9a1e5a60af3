// SPDX-License-Identifier: Apache-2.0
#include "gltf_json.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "input_files.h"

namespace tempera {
namespace {

constexpr std::size_t kMaxDepth = 256;  // parsing would take any depth; a pointer of that length helps nobody

/// Characters for the parser; `*consumed` tells the builder where it stands.
class CountingIterator {
 public:
  using iterator_category = std::input_iterator_tag;
  using value_type = char;
  using difference_type = std::ptrdiff_t;
  using pointer = const char*;
  using reference = const char&;
  CountingIterator(const char* p, std::size_t* consumed) : p_(p), consumed_(consumed) {}
  reference operator*() const { return *p_; }
  CountingIterator& operator++() { return ++p_, ++*consumed_, *this; }
  CountingIterator operator++(int) {
    CountingIterator old = *this;
    ++*this;
    return old;
  }
  bool operator==(const CountingIterator& o) const { return p_ == o.p_; }
  bool operator!=(const CountingIterator& o) const { return p_ != o.p_; }

 private:
  const char* p_;
  std::size_t* consumed_;
};

}  // namespace

/// Receives nlohmann's events and fills the document.
class JsonBuilder {
 public:
  JsonBuilder(JsonDocument& document, std::size_t begin, std::size_t end, std::uint64_t memory_limit)
      : d_(document), begin_(begin), end_(end), memory_limit_(memory_limit), token_end_(begin) {}

  std::size_t* consumed() { return &consumed_; }

  bool null() { return add(JsonDocument::Kind::kNull), true; }
  bool boolean(bool v) { return add(JsonDocument::Kind::kBoolean).number = v, true; }
  bool number_integer(std::int64_t v) { return add(JsonDocument::Kind::kNumber).number = double(v), true; }
  bool number_unsigned(std::uint64_t v) { return add(JsonDocument::Kind::kNumber).number = double(v), true; }
  bool number_float(double v, const std::string&) { return add(JsonDocument::Kind::kNumber).number = v, true; }
  bool binary(std::vector<std::uint8_t>&) { return false; }  // only in binary formats
  bool string(std::string& v) {
    const auto [begin, size] = store(v);
    JsonDocument::Node& node = add(JsonDocument::Kind::kString);
    node.begin = begin, node.size = size;
    return true;
  }
  bool start_object(std::size_t) { return open(JsonDocument::Kind::kObject); }
  bool start_array(std::size_t) { return open(JsonDocument::Kind::kArray); }
  bool end_object() { return close(); }
  bool end_array() { return close(); }
  bool key(std::string& v) {
    std::tie(key_begin_, key_size_) = store(v);
    token_end_ = begin_ + consumed_;
    return true;
  }
  bool parse_error(std::size_t, const std::string&, const nlohmann::json::exception& e) {
    // "[json.exception.parse_error.101] parse error at line 1, column 2: syntax error while parsing ...": ours says
    // where
    std::string_view what = e.what();
    if (const std::size_t i = what.find("syntax error"); i != what.npos) what.remove_prefix(i);
    throw Error(ErrorCode::kSyntax, d_.loc(begin_ + (consumed_ > 0 ? consumed_ - 1 : 0)),
                "not valid JSON: " + std::string(what));
  }

 private:
  std::pair<std::uint32_t, std::uint32_t> store(const std::string& v) {
    const auto begin = std::uint32_t(d_.strings_.size());
    d_.strings_ += v;
    return {begin, std::uint32_t(v.size())};
  }

  JsonDocument::Node& add(JsonDocument::Kind kind) {
    // The token starts at the first byte after the previous one that is no separator.
    std::size_t offset = token_end_;
    const auto separates = [](char c) {
      return c == ' ' || c == '\t' || c == '\n' || c == '\r' || c == ',' || c == ':';
    };
    while (offset < end_ && separates(d_.text_[offset])) ++offset;
    token_end_ = begin_ + consumed_;

    if (memory_limit_ != 0 && (d_.nodes_.size() + 1) * (sizeof(JsonDocument::Node) + 8) > memory_limit_)
      throw Error(ErrorCode::kOutOfMemory, d_.loc(offset), "the JSON document alone passes the memory limit");
    JsonDocument::Node node;
    node.kind = kind;
    node.offset = offset;
    node.key_begin = key_begin_, node.key_size = key_size_;
    key_begin_ = key_size_ = 0;
    const auto index = std::uint32_t(d_.nodes_.size());
    if (!stack_.empty()) {
      node.parent = stack_.back().node;
      node.position = std::uint32_t(stack_.back().children.size());
      stack_.back().children.push_back(index);
    }
    d_.nodes_.push_back(node);
    return d_.nodes_.back();
  }

  bool open(JsonDocument::Kind kind) {
    const auto index = std::uint32_t(d_.nodes_.size());
    const std::size_t offset = add(kind).offset;
    if (stack_.size() >= kMaxDepth)
      throw Error(ErrorCode::kSyntax, d_.loc(offset), fmt::format("nested deeper than {} levels", kMaxDepth));
    stack_.push_back({index, {}});
    return true;
  }

  bool close() {
    token_end_ = begin_ + consumed_;
    JsonDocument::Node& node = d_.nodes_[stack_.back().node];
    const std::vector<std::uint32_t>& children = stack_.back().children;
    node.begin = std::uint32_t(d_.children_.size());
    node.size = std::uint32_t(children.size());
    d_.children_.insert(d_.children_.end(), children.begin(), children.end());
    stack_.pop_back();
    return true;
  }

  struct Open {
    std::uint32_t node;
    std::vector<std::uint32_t> children;
  };
  JsonDocument& d_;
  std::size_t begin_, end_;
  std::uint64_t memory_limit_;
  std::size_t consumed_ = 0;
  std::size_t token_end_;
  std::uint32_t key_begin_ = 0, key_size_ = 0;
  std::vector<Open> stack_;
};

JsonDocument::JsonDocument(std::string file, std::string_view text, std::size_t begin, std::size_t end,
                           std::uint64_t memory_limit)
    : file_(std::move(file)), text_(text) {
  for (std::size_t at = text.find('\n'); at < end; at = text.find('\n', at + 1)) lines_.push_back(at + 1);
  if (end - begin > std::size_t(1) << 31)
    throw Error(ErrorCode::kSyntax, loc(begin), "a JSON document of more than 2 GiB");
  begin = end - skip_byte_order_mark(text.substr(begin, end - begin)).size();
  if (const std::string_view mark = text.substr(begin, 2);
      end - begin >= 2 && (mark == "\xFF\xFE" || mark == "\xFE\xFF"))
    throw Error(ErrorCode::kSyntax, loc(begin), "is UTF-16, as its byte order mark says; glTF is UTF-8");
  JsonBuilder builder(*this, begin, end, memory_limit);
  const CountingIterator first(text.data() + begin, builder.consumed()), last(text.data() + end, builder.consumed());
  nlohmann::json::sax_parse(first, last, &builder);  // the builder throws on errors
  if (nodes_.empty() || nodes_[0].kind != Kind::kObject)
    throw Error(ErrorCode::kSyntax, loc(begin), "not a glTF file: its JSON is not an object");
}

SourceLoc JsonDocument::loc(std::size_t offset) const {
  // As `locate`, but a file may ask for the places of all its textures: no counting from the start each time.
  const auto next = std::upper_bound(lines_.begin(), lines_.end(), offset);
  const std::size_t start = next == lines_.begin() ? 0 : *(next - 1);
  return {file_, int(next - lines_.begin()) + 1, int(offset - start) + 1};
}

bool Json::is_object() const { return *this && document_->nodes_[node_].kind == JsonDocument::Kind::kObject; }
bool Json::is_array() const { return *this && document_->nodes_[node_].kind == JsonDocument::Kind::kArray; }
bool Json::is_string() const { return *this && document_->nodes_[node_].kind == JsonDocument::Kind::kString; }

Json Json::operator[](std::string_view key) const {
  if (!*this) return *this;
  object();
  const JsonDocument::Node& node = document_->nodes_[node_];
  for (std::uint32_t i = 0; i < node.size; ++i) {
    const Json child(document_, document_->children_[node.begin + i]);
    if (child.key() == key) return child;
  }
  Json result = *this;
  result.missing_ = true;
  result.missing_key_ = key;
  return result;
}

Json Json::at(std::size_t i) const {
  const JsonDocument::Node& node = document_->nodes_[node_];
  TEMPERA_ASSERT(i < node.size);
  return {document_, document_->children_[node.begin + i]};
}

std::size_t Json::size() const {
  if (!*this) return 0;
  if (!is_array() && !is_object()) wrong_type("an array");
  return document_->nodes_[node_].size;
}

std::string_view Json::key() const {
  const JsonDocument::Node& node = document_->nodes_[node_];
  return std::string_view(document_->strings_).substr(node.key_begin, node.key_size);
}

const Json& Json::required() const {
  if (!*this) fail(fmt::format("lacks the required property \"{}\"", missing_key_));
  return *this;
}

const Json& Json::object() const {
  if (*this && !is_object()) wrong_type("an object");
  return *this;
}

const Json& Json::array() const {
  if (*this && !is_array()) wrong_type("an array");
  return *this;
}

bool Json::boolean(bool fallback) const {
  if (!*this) return fallback;
  const JsonDocument::Node& node = document_->nodes_[node_];
  if (node.kind != JsonDocument::Kind::kBoolean) wrong_type("true or false");
  return node.number != 0;
}

double Json::number(double fallback) const {
  if (!*this) return fallback;
  const JsonDocument::Node& node = document_->nodes_[node_];
  if (node.kind != JsonDocument::Kind::kNumber) wrong_type("a number");
  return node.number;
}

double Json::number(double fallback, double min, double max) const {
  const double v = number(fallback);
  if (*this && !(v >= min && v <= max))
    fail(ErrorCode::kOutOfRange, fmt::format("{} is outside [{}, {}]", v, min, max));
  return v;
}

std::string_view Json::string(std::string_view fallback) const {
  if (!*this) return fallback;
  if (!is_string()) wrong_type("a string");
  const JsonDocument::Node& node = document_->nodes_[node_];
  return std::string_view(document_->strings_).substr(node.begin, node.size);
}

std::uint64_t Json::integer(std::uint64_t fallback) const {
  if (!*this) return fallback;
  const double v = number(0);
  if (!(v >= 0 && v <= 9007199254740992.0) || v != std::floor(v))
    fail(fmt::format("{} is not a non-negative whole number", v));
  return std::uint64_t(v);
}

int Json::index(std::size_t size, std::string_view target) const {
  const std::uint64_t i = required().integer(0);
  if (i >= size) fail(fmt::format("refers to {}[{}], but there are {}", target, i, size));
  return int(i);
}

int Json::optional_index(std::size_t size, std::string_view target) const { return *this ? index(size, target) : -1; }

bool Json::numbers(double* out, std::size_t n) const {
  if (!*this) return false;
  array();
  if (size() != n) fail(fmt::format("has {} elements instead of {}", size(), n));
  for (std::size_t i = 0; i < n; ++i) out[i] = at(i).number(0);
  return true;
}

SourceLoc Json::loc() const {
  if (!document_) return {};
  return document_->loc(document_->nodes_[node_].offset);
}

std::string Json::pointer() const {
  std::string path;
  if (!document_) return path;
  const auto& nodes = document_->nodes_;
  for (std::uint32_t i = node_; i != 0; i = nodes[i].parent) {
    const bool member = nodes[nodes[i].parent].kind == JsonDocument::Kind::kObject;
    path = (member ? fmt::format("/{}", Json(document_, i).key()) : fmt::format("/{}", nodes[i].position)) + path;
  }
  return path;
}

void Json::fail(ErrorCode code, const std::string& message) const {
  const std::string path = pointer();
  throw Error(code, loc(), path.empty() ? message : path + ": " + message);
}

void Json::wrong_type(std::string_view wanted) const {
  using Kind = JsonDocument::Kind;
  const Kind kind = document_->nodes_[node_].kind;
  fail(fmt::format("is {} instead of {}",
                   kind == Kind::kNull      ? "null"
                   : kind == Kind::kBoolean ? "a boolean"
                   : kind == Kind::kNumber  ? "a number"
                   : kind == Kind::kString  ? "a string"
                   : kind == Kind::kArray   ? "an array"
                                            : "an object",
                   wanted));
}

}  // namespace tempera
