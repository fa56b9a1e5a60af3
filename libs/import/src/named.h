// SPDX-License-Identifier: Apache-2.0
#pragma once
// Tables of what the names in a file mean: an addition is one line, and messages list what is valid from them.
#include <algorithm>
#include <cstddef>
#include <iterator>
#include <string>
#include <string_view>

namespace tempera {

template <class T>
struct Named {
  std::string_view name;
  T value;
};

/// The entry of that name; null if there is none.
template <class T, std::size_t N>
const Named<T>* find_named(const Named<T> (&table)[N], std::string_view name) {
  const auto* entry = std::find_if(std::begin(table), std::end(table), [&](const auto& e) { return e.name == name; });
  return entry == std::end(table) ? nullptr : entry;
}

/// All names in the order of the table: "a, b, c".
template <class T, std::size_t N>
std::string names_of(const Named<T> (&table)[N]) {
  std::string names;
  for (const Named<T>& entry : table) {
    if (!names.empty()) names += ", ";
    names += entry.name;
  }
  return names;
}

}  // namespace tempera
