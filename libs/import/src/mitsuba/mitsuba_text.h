// SPDX-License-Identifier: Apache-2.0
#pragma once
// The words and numbers in attributes of Mitsuba's files.
#include <string>
#include <string_view>
#include <vector>

namespace tempera::mitsuba {

/// intIOR -> int_ior, toWorld -> to_world.
std::string snake_case(std::string_view name);
/// ASCII letters in lower case.
std::string lower_case(std::string text);
/// Without blanks at both ends.
std::string_view trim(std::string_view text);
/// What stands between blanks and commas.
std::vector<std::string_view> split(std::string_view text);
/// False unless the whole text, but for blanks around it, is a number; one too large for a double becomes infinite.
bool parse_number(std::string_view text, double& value);
/// Numbers separated by blanks and commas. False if something else is in `text` or a number is not finite.
bool parse_numbers(std::string_view text, std::vector<double>& numbers);

}  // namespace tempera::mitsuba
