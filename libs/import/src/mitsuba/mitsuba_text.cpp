// SPDX-License-Identifier: Apache-2.0
#include "mitsuba_text.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstdlib>

namespace tempera::mitsuba {
namespace {

bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; }
bool is_separator(char c) { return is_blank(c) || c == ','; }

}  // namespace

std::string snake_case(std::string_view name) {
  const auto lower = [](char c) { return c >= 'a' && c <= 'z'; };
  const auto upper = [](char c) { return c >= 'A' && c <= 'Z'; };
  std::string result;
  for (std::size_t i = 0; i < name.size(); ++i) {
    if (i > 0 && lower(name[i - 1]) && upper(name[i])) {
      result += '_';
      for (; i < name.size() && upper(name[i]); ++i) result += char(name[i] - 'A' + 'a');
      if (i == name.size()) break;
    }
    result += name[i];
  }
  return result;
}

std::string_view trim(std::string_view text) {
  while (!text.empty() && is_blank(text.front())) text.remove_prefix(1);
  while (!text.empty() && is_blank(text.back())) text.remove_suffix(1);
  return text;
}

bool parse_number(std::string_view text, double& value) {
  text = trim(text);
  if (text.starts_with('+')) text.remove_prefix(1);
  const auto [end, failed] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (failed == std::errc::result_out_of_range) value = std::strtod(std::string(text).c_str(), nullptr);  // 0 or inf
  return (failed == std::errc() || failed == std::errc::result_out_of_range) && end == text.data() + text.size();
}

std::vector<std::string_view> split(std::string_view text) {
  std::vector<std::string_view> words;
  for (std::size_t i = 0; i < text.size();) {
    while (i < text.size() && is_separator(text[i])) ++i;
    const std::size_t begin = i;
    while (i < text.size() && !is_separator(text[i])) ++i;
    if (i > begin) words.push_back(text.substr(begin, i - begin));
  }
  return words;
}

std::string lower_case(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return char(std::tolower(c)); });
  return text;
}

bool parse_numbers(std::string_view text, std::vector<double>& numbers) {
  numbers.clear();
  for (std::string_view word : split(text)) {
    double v;
    if (!parse_number(word, v) || !std::isfinite(v)) return false;
    numbers.push_back(v);
  }
  return true;
}

}  // namespace tempera::mitsuba
