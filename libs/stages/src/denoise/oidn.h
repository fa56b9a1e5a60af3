// SPDX-License-Identifier: Apache-2.0
#pragma once
// Open Image Denoise, loaded when it is asked for and never linked. Private to the denoiser.
#include <memory>
#include <string>

#include "denoise/planes.h"

namespace tempera::denoise {

/// The library and a device of it that runs on the CPU.
class Oidn {
 public:
  /// Loads `path`; if that is empty, the environment variable TEMPERA_OIDN, else what the loader finds as
  /// libOpenImageDenoise.so.2. Errors: Error{kUnsupported} if there is none, or it is not of version 2.
  explicit Oidn(const std::string& path);
  ~Oidn();
  Oidn(const Oidn&) = delete;
  Oidn& operator=(const Oidn&) = delete;

  const std::string& version() const;  ///< "2.5.1"
  /// Denoises [h,w,3]. `color`: radiance from 0 on. `albedo` in [0,1] and `normal` in [-1,1]: features, without noise
  /// if `clean_features`. `thorough`: with the larger network, which takes more than twice the time, as noisy features do.
  Planes denoise(const Planes& color, const Planes& albedo, const Planes& normal, bool clean_features, bool thorough);
  /// Denoises a feature alone. `name`: "albedo" or "normal".
  Planes prefilter(const std::string& name, const Planes& feature);

 private:
  struct Library;
  std::unique_ptr<Library> library_;
};

}  // namespace tempera::denoise
