// SPDX-License-Identifier: Apache-2.0
// Stands in for Open Image Denoise in tests: the functions of version 2 that are used, with a mean over 3x3 pixels as
// the filter. Environment variable TEMPERA_OIDN_STUB_VERSION sets the version that it claims to be.
#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <map>
#include <string>

namespace {

struct Image {
  float* data = nullptr;
  std::size_t width = 0, height = 0;
};

}  // namespace

struct Device {
  int threads = 0;
  const char* error = nullptr;
};
struct Filter {
  Device* device = nullptr;
  std::map<std::string, Image> images;
  std::map<std::string, int> options;
  bool committed = false;
};

extern "C" {
Device* oidnNewDevice(int) { return new Device; }
void oidnCommitDevice(Device*) {}
void oidnReleaseDevice(Device* d) { delete d; }
int oidnGetDeviceError(Device* d, const char** message) {
  if (!d || !d->error) return 0;
  *message = d->error;
  d->error = nullptr;
  return 2;
}
void oidnSetDeviceInt(Device* d, const char*, int value) { d->threads = value; }
int oidnGetDeviceInt(Device*, const char*) {
  const char* version = std::getenv("TEMPERA_OIDN_STUB_VERSION");
  return version ? std::atoi(version) : 20304;
}
Filter* oidnNewFilter(Device* d, const char*) {
  Filter* f = new Filter;
  f->device = d;
  return f;
}
void oidnReleaseFilter(Filter* f) { delete f; }
void oidnSetSharedFilterImage(Filter* f, const char* name, void* data, int, std::size_t width, std::size_t height,
                              std::size_t, std::size_t, std::size_t) {
  f->images[name] = {static_cast<float*>(data), width, height};
}
void oidnSetFilterBool(Filter* f, const char* name, bool value) { f->options[name] = value; }
void oidnSetFilterInt(Filter* f, const char* name, int value) { f->options[name] = value; }
void oidnCommitFilter(Filter* f) { f->committed = true; }
void oidnExecuteFilter(Filter* f) {
  // What the library refuses, too.
  const bool color = f->images.contains("color");
  if (!f->committed || (f->images.contains("normal") && color && !f->images.contains("albedo"))) {
    f->device->error = "unsupported combination of images";
    return;
  }
  const Image in = color                          ? f->images["color"]
                   : f->images.contains("albedo") ? f->images["albedo"]
                                                  : f->images["normal"];
  const Image out = f->images["output"];
  const int width = int(in.width), height = int(in.height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (int c = 0; c < 3; ++c) {
        float sum = 0;
        int count = 0;
        for (int j = std::max(y - 1, 0); j <= std::min(y + 1, height - 1); ++j) {
          for (int i = std::max(x - 1, 0); i <= std::min(x + 1, width - 1); ++i, ++count)
            sum += in.data[(j * width + i) * 3 + c];
        }
        out.data[(y * width + x) * 3 + c] = sum / float(count);
      }
    }
  }
}
}
