// SPDX-License-Identifier: Apache-2.0
#include "denoise/oidn.h"

#include <dlfcn.h>
#include <fmt/format.h>

#include <cstdlib>
#include <filesystem>
#include <map>

#include "tempera/core/error.h"

namespace tempera::denoise {

namespace {

// What we use of version 2 of its C interface.
using Device = struct OpaqueDevice*;
using Filter = struct OpaqueFilter*;
constexpr int kDeviceCpu = 1, kFormatFloat3 = 3, kQualityBalanced = 5, kQualityHigh = 6;

constexpr int kMemory = 400;  ///< megabytes that it may take, beyond which it works in tiles

constexpr const char* kDefaultLibrary = "libOpenImageDenoise.so.2";

/// Where the library lies that came with the program or was put beside it: PREFIX/lib for PREFIX/bin/tempera.
std::string beside_program() {
  std::error_code failed;
  const std::filesystem::path program = std::filesystem::read_symlink("/proc/self/exe", failed);
  return failed ? "" : (program.parent_path().parent_path() / "lib" / kDefaultLibrary).string();
}

}  // namespace

struct Oidn::Library {
  explicit Library(const std::string& asked) {
    const char* const variable = std::getenv("TEMPERA_OIDN");
    const std::string path = !asked.empty() ? asked : variable && *variable ? variable : kDefaultLibrary;
    handle = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
    const char* const why = handle ? nullptr : dlerror();
    const std::string error = why ? why : path;
    if (const std::string beside = beside_program(); !handle && path == kDefaultLibrary && !beside.empty())
      handle = dlopen(beside.c_str(), RTLD_NOW | RTLD_LOCAL);
    if (!handle) {
      throw Error(ErrorCode::kUnsupported,
                  fmt::format("Open Image Denoise cannot be loaded: {}; name the file of version 2 with --oidn or "
                              "TEMPERA_OIDN, or take method nl_means",
                              error));
    }
    try {
      open(path);
    } catch (...) {
      close();
      throw;
    }
  }
  ~Library() { close(); }

  template <class F>
  void find(F& function, const char* name, const std::string& path) {
    function = reinterpret_cast<F>(dlsym(handle, name));
    if (!function) {
      throw Error(ErrorCode::kUnsupported,
                  fmt::format("{} has no {}, which version 2 of Open Image Denoise has", path, name));
    }
  }

  void open(const std::string& path) {
    find(new_device, "oidnNewDevice", path), find(commit_device, "oidnCommitDevice", path);
    find(release_device, "oidnReleaseDevice", path), find(device_error, "oidnGetDeviceError", path);
    find(set_device_int, "oidnSetDeviceInt", path), find(get_device_int, "oidnGetDeviceInt", path);
    find(new_filter, "oidnNewFilter", path), find(release_filter, "oidnReleaseFilter", path);
    find(set_image, "oidnSetSharedFilterImage", path), find(set_bool, "oidnSetFilterBool", path);
    find(set_int, "oidnSetFilterInt", path), find(commit_filter, "oidnCommitFilter", path);
    find(execute_filter, "oidnExecuteFilter", path);
    device = new_device(kDeviceCpu);
    if (device) {
      set_device_int(device, "numThreads", thread_count());
      commit_device(device);
    }
    check();
    const int number = get_device_int(device, "version");
    version = fmt::format("{}.{}.{}", number / 10000, number / 100 % 100, number % 100);
    if (number / 10000 != 2) {
      throw Error(ErrorCode::kUnsupported,
                  fmt::format("{} is Open Image Denoise {}; version 2 is needed", path, version));
    }
  }

  void close() {
    for (auto& [key, filter] : filters) release_filter(filter.handle);
    filters.clear();
    if (device) release_device(device);
    device = nullptr;
    // The library stays: threads of its own may still be ending.
  }

  void check() {
    const char* message = nullptr;
    if (const int code = device_error(device, &message); code != 0 || !device) {
      throw Error(ErrorCode::kFailed,
                  fmt::format("Open Image Denoise: {}", message ? message : fmt::format("error {}", code)));
    }
  }

  struct Prepared {
    Filter handle = nullptr;
    std::map<std::string, Image> images;
  };

  /// Images of a filter keep their place, so that it need not be prepared for every frame.
  Prepared& prepared(const std::vector<std::string>& names, bool clean_features, bool thorough, int width, int height) {
    Prepared& p =
        filters[fmt::format("{} {} {} {} {}", fmt::join(names, " "), clean_features, thorough, width, height)];
    if (p.handle) return p;
    p.handle = new_filter(device, "RT");
    check();
    for (const std::string& name : names) p.images[name] = Image(width, height, 3);
    p.images["output"] = Image(width, height, 3);
    for (auto& [name, image] : p.images) {
      set_image(p.handle, name.c_str(), image.values().data(), kFormatFloat3, std::size_t(width), std::size_t(height),
                0, 0, 0);
    }
    const bool color = names.front() == "color";
    if (color) set_bool(p.handle, "hdr", true);
    if (color && names.size() > 1 && clean_features) set_bool(p.handle, "cleanAux", true);
    set_int(p.handle, "maxMemoryMB", kMemory);
    set_int(p.handle, "quality", thorough ? kQualityHigh : kQualityBalanced);
    commit_filter(p.handle);
    check();
    return p;
  }

  Planes run(const std::vector<std::pair<std::string, const Planes*>>& inputs, bool clean_features, bool thorough) {
    std::vector<std::string> names;
    for (const auto& [name, planes] : inputs) names.push_back(name);
    const Planes& first = *inputs.front().second;
    Prepared& p = prepared(names, clean_features, thorough, first.width(), first.height());
    for (const auto& [name, planes] : inputs) {
      const Image from = planes->image();
      std::copy(from.values().begin(), from.values().end(), p.images[name].values().begin());
    }
    execute_filter(p.handle);
    check();
    return Planes(p.images["output"], 3);
  }

  void* handle = nullptr;
  Device device = nullptr;
  std::string version;
  std::map<std::string, Prepared> filters;
  Device (*new_device)(int) = nullptr;
  void (*commit_device)(Device) = nullptr;
  void (*release_device)(Device) = nullptr;
  int (*device_error)(Device, const char**) = nullptr;
  void (*set_device_int)(Device, const char*, int) = nullptr;
  int (*get_device_int)(Device, const char*) = nullptr;
  Filter (*new_filter)(Device, const char*) = nullptr;
  void (*release_filter)(Filter) = nullptr;
  void (*set_image)(Filter, const char*, void*, int, std::size_t, std::size_t, std::size_t, std::size_t,
                    std::size_t) = nullptr;
  void (*set_bool)(Filter, const char*, bool) = nullptr;
  void (*set_int)(Filter, const char*, int) = nullptr;
  void (*commit_filter)(Filter) = nullptr;
  void (*execute_filter)(Filter) = nullptr;
};

Oidn::Oidn(const std::string& path) : library_(std::make_unique<Library>(path)) {}
Oidn::~Oidn() = default;

const std::string& Oidn::version() const { return library_->version; }

Planes Oidn::denoise(const Planes& color, const Planes& albedo, const Planes& normal, bool clean_features,
                     bool thorough) {
  std::vector<std::pair<std::string, const Planes*>> inputs{{"color", &color}};
  // The library takes a normal only beside an albedo.
  if (!albedo.empty()) inputs.emplace_back("albedo", &albedo);
  if (!albedo.empty() && !normal.empty()) inputs.emplace_back("normal", &normal);
  return library_->run(inputs, clean_features, thorough);
}

Planes Oidn::prefilter(const std::string& name, const Planes& feature) {
  return library_->run({{name, &feature}}, false, false);
}

}  // namespace tempera::denoise
