// SPDX-License-Identifier: Apache-2.0
// Denoises frames one by one with Open Image Denoise (./dev oidn fetches it), for comparisons: its library is loaded
// when this program runs, so that nothing else depends on it. Frames need the layers albedo and normal; what is written
// has color alone.
//
//   denoise LIBRARY INPUT OUTPUT [--clean] [--threads N]
//
// INPUT and OUTPUT are patterns such as out/f.####.exr. --clean: albedo and normal are denoised first.
#include <dlfcn.h>
#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include "tempera/core/parallel.h"
#include "tempera/core/time.h"
#include "tempera/frames/frame.h"
#include "tempera/frames/sequence.h"

namespace {

using namespace tempera;

/// The part of Open Image Denoise's C interface (version 2) that is used here.
struct Library {
  struct Device;
  struct Filter;
  static constexpr int kCpu = 1, kFloat3 = 3;

  explicit Library(const char* path) {
    void* const handle = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!handle) throw Error(ErrorCode::kFailed, fmt::format("cannot load {}: {}", path, dlerror()));
    const auto load = [&](auto& function, const char* name) {
      function = reinterpret_cast<std::remove_reference_t<decltype(function)>>(dlsym(handle, name));
      if (!function) throw Error(ErrorCode::kFailed, fmt::format("{} has no {}", path, name));
    };
    load(new_device, "oidnNewDevice");
    load(set_device_bool, "oidnSetDeviceBool");
    load(set_device_int, "oidnSetDeviceInt");
    load(commit_device, "oidnCommitDevice");
    load(device_error, "oidnGetDeviceError");
    load(new_filter, "oidnNewFilter");
    load(set_image, "oidnSetSharedFilterImage");
    load(set_filter_bool, "oidnSetFilterBool");
    load(commit_filter, "oidnCommitFilter");
    load(execute_filter, "oidnExecuteFilter");
    load(release_filter, "oidnReleaseFilter");
    load(release_device, "oidnReleaseDevice");
  }

  Device* (*new_device)(int type);
  void (*set_device_bool)(Device*, const char*, bool);
  void (*set_device_int)(Device*, const char*, int);
  void (*commit_device)(Device*);
  int (*device_error)(Device*, const char** message);
  Filter* (*new_filter)(Device*, const char* type);
  void (*set_image)(Filter*, const char* name, void* data, int format, std::size_t width, std::size_t height,
                    std::size_t offset, std::size_t pixel_stride, std::size_t row_stride);
  void (*set_filter_bool)(Filter*, const char*, bool);
  void (*commit_filter)(Filter*);
  void (*execute_filter)(Filter*);
  void (*release_filter)(Filter*);
  void (*release_device)(Device*);
};

class Denoiser {
 public:
  Denoiser(const char* path, int threads) : library_(path), device_(library_.new_device(Library::kCpu)) {
    library_.set_device_bool(device_, "setAffinity", false);  // other programs may run on this machine
    if (threads > 0) library_.set_device_int(device_, "numThreads", threads);
    library_.commit_device(device_);
    check();
  }
  ~Denoiser() { library_.release_device(device_); }
  Denoiser(const Denoiser&) = delete;
  Denoiser& operator=(const Denoiser&) = delete;

  /// The image named "output" of a filter of others [h,w,3], by their names.
  Image filter(std::vector<std::pair<const char*, Image*>> inputs, bool hdr, bool clean) {
    Image out(inputs[0].second->width(), inputs[0].second->height(), 3);
    inputs.emplace_back("output", &out);
    Library::Filter* const filter = library_.new_filter(device_, "RT");
    for (const auto& [name, image] : inputs) {
      library_.set_image(filter, name, image->values().data(), Library::kFloat3, std::size_t(image->width()),
                         std::size_t(image->height()), 0, 0, 0);
    }
    if (hdr) library_.set_filter_bool(filter, "hdr", true);
    if (clean) library_.set_filter_bool(filter, "cleanAux", true);
    library_.commit_filter(filter);
    library_.execute_filter(filter);
    library_.release_filter(filter);
    check();
    return out;
  }

 private:
  void check() const {
    const char* message = nullptr;
    if (library_.device_error(device_, &message) != 0) {
      throw Error(ErrorCode::kFailed, fmt::format("Open Image Denoise: {}", message ? message : "failed"));
    }
  }
  Library library_;
  Library::Device* device_;
};

/// The first three channels.
Image three_channels(const Image& image) {
  Image out(image.width(), image.height(), 3);
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) out.set_rgb(x, y, image.rgb(x, y));
  }
  return out;
}

void denoise(const char* library, const std::string& input, const std::string& output, bool clean, int threads) {
  Denoiser denoiser(library, threads);
  const FrameSequence sequence(input);
  for (const int number : sequence.frames()) {
    Frame frame = read_frame(sequence.path(number), {{"color", "albedo", "normal"}});
    Image color = three_channels(frame.layer("color"));
    Image albedo = three_channels(frame.layer("albedo")), normal = three_channels(frame.layer("normal"));
    for (float& v : albedo.values()) v = std::clamp(v, 0.0f, 1.0f);  // what the network was trained on
    if (clean) {
      albedo = denoiser.filter({{"albedo", &albedo}}, false, false);
      normal = denoiser.filter({{"normal", &normal}}, false, false);
    }
    Frame out(frame.width(), frame.height());
    out.metadata = frame.metadata;
    LayerDesc desc = layers::color();
    desc.channels.resize(3);
    out.add(desc, denoiser.filter({{"color", &color}, {"albedo", &albedo}, {"normal", &normal}}, true, clean));
    write_frame(frame_path(output, number), out);
  }
}

}  // namespace

int main(int argc, char** argv) {
  std::vector<const char*> paths;
  bool clean = false;
  int threads = 0;
  for (int i = 1; i < argc; ++i) {
    if (!std::strcmp(argv[i], "--clean")) {
      clean = true;
    } else if (!std::strcmp(argv[i], "--threads") && i + 1 < argc) {
      threads = std::atoi(argv[++i]);
    } else {
      paths.push_back(argv[i]);
    }
  }
  if (paths.size() != 3) {
    std::fprintf(stderr, "usage: denoise LIBRARY INPUT OUTPUT [--clean] [--threads N]\n");
    return 2;
  }
  try {
    with_threads(threads, [&] { denoise(paths[0], paths[1], paths[2], clean, threads); });
  } catch (const Error& e) {
    std::fprintf(stderr, "denoise: %s\n", e.message().c_str());
    return 1;
  }
  return 0;
}
