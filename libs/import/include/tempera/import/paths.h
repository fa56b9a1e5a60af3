// SPDX-License-Identifier: Apache-2.0
#pragma once
// Names of files inside of files, whatever system wrote them.
#include <filesystem>
#include <string>

namespace tempera {

/// The file that `name` means, counted from `folder`: as it stands if that exists, else with backslashes as separators,
/// as files from Windows have them.
std::filesystem::path named_file(const std::filesystem::path& folder, const std::string& name);

/// "cannot find the file \"...\"", with the name that differs in upper and lower case only, if there is one.
std::string cannot_find(const std::filesystem::path& file);

}  // namespace tempera
