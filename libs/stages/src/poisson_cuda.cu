// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>
#include <string>

#include "poisson_cuda.h"
#include "tempera/core/error.h"

namespace tempera {
namespace {

constexpr int kThreads = 256;    ///< a block
constexpr int kSumBlocks = 512;  ///< of reductions: fixed, so that sums do not depend on the device's size

void check(cudaError_t status) {
  if (status == cudaSuccess) return;
  const bool memory = status == cudaErrorMemoryAllocation;
  throw Error(memory ? ErrorCode::kOutOfMemory : ErrorCode::kFailed,
              memory ? std::string("the CUDA device has too little memory for a window; make --window smaller")
                     : std::string("CUDA: ") + cudaGetErrorString(status));
}

/// Memory of the device, zero at first.
template <class T>
class DeviceArray {
 public:
  explicit DeviceArray(std::size_t n) : size_(n) {
    if (n == 0) return;
    check(cudaMalloc(reinterpret_cast<void**>(&data_), n * sizeof(T)));
    check(cudaMemset(data_, 0, n * sizeof(T)));
  }
  explicit DeviceArray(const std::vector<T>& host) : DeviceArray(host.size()) { upload(host.data()); }
  ~DeviceArray() { cudaFree(data_); }
  DeviceArray(const DeviceArray&) = delete;
  DeviceArray& operator=(const DeviceArray&) = delete;

  void upload(const T* host) {
    if (size_ > 0) check(cudaMemcpy(data_, host, size_ * sizeof(T), cudaMemcpyHostToDevice));
  }
  void download(T* host) const { check(cudaMemcpy(host, data_, size_ * sizeof(T), cudaMemcpyDeviceToHost)); }
  T* data() { return data_; }
  const T* data() const { return data_; }

 private:
  T* data_ = nullptr;
  std::size_t size_;
};

struct Rgb3 {
  float v[3];
};
struct SquaredWeights {
  float of[kRowSets];
};

namespace kernels {

__device__ int thread_index() { return int(blockIdx.x * blockDim.x + threadIdx.x); }

/// W^2 of sets times precisions, 0 where there is no row.
__global__ void set_weights(FlatRows m, SquaredWeights w0, const float* precision, float* squared) {
  const int g = thread_index(), n = m.pixels();
  if (g >= n) return;
  for (int s = 0; s < kRowSets; ++s) {
    const std::size_t row = std::size_t(s) * n + g;
    squared[row] = m.exists(RowSet(s), g) ? w0.of[s] * (precision ? precision[row] : 1.0f) : 0.0f;
  }
}

/// residual = W^2 (A x - b), b = 0 if null.
__global__ void weigh_residuals(FlatRows m, const float* squared, const float* x, const float* data, float* residual) {
  const int g = thread_index(), n = m.pixels();
  if (g >= n) return;
  for (int s = 0; s < kRowSets; ++s) {
    const std::size_t row = std::size_t(s) * n + g;
    const bool exists = m.exists(RowSet(s), g);
    for (int c = 0; c < 3; ++c) {
      const float b = data ? data[3 * row + c] : 0.0f;
      residual[3 * row + c] = exists ? squared[row] * (m.value(RowSet(s), g, x, c) - b) : 0.0f;
    }
  }
}

/// out = sign A^T residual.
__global__ void transpose(FlatRows m, const float* residual, float sign, float* out) {
  const int g = thread_index(), n = m.pixels();
  if (g >= n) return;
  float sum[3] = {};
  m.for_each_row_of(g, [&](RowSet set, int row, float coefficient) {
    const float* r = residual + 3 * (std::size_t(set) * n + row);
    for (int c = 0; c < 3; ++c) sum[c] += coefficient * r[c];
  });
  for (int c = 0; c < 3; ++c) out[3 * std::size_t(g) + c] = sign * sum[c];
}

/// 1 / the diagonal of A^T W^2 A, or 1 for uniform weights, where it is all but constant.
__global__ void invert_diagonal(FlatRows m, const float* squared, bool uniform, float* inverse) {
  const int g = thread_index(), n = m.pixels();
  if (g >= n) return;
  float sum = 0;
  m.for_each_row_of(g, [&](RowSet set, int row, float) { sum += squared[std::size_t(set) * n + row]; });
  inverse[g] = uniform ? 1.0f : 1 / sum;
}

/// Sums over a block by halves; the result is in sums[0].
__device__ void add_up(double (*sums)[3], const double (&own)[3]) {
  for (int c = 0; c < 3; ++c) sums[threadIdx.x][c] = own[c];
  __syncthreads();
  for (int half = kThreads / 2; half > 0; half /= 2) {
    if (int(threadIdx.x) < half) {
      for (int c = 0; c < 3; ++c) sums[threadIdx.x][c] += sums[threadIdx.x + half][c];
    }
    __syncthreads();
  }
}

/// parts[block] = sums of a b d over the block's pixels; d counts pixels, a and b pixels and channels.
__global__ void dot(int pixels, const float* a, const float* b, const float* d, double* parts) {
  __shared__ double sums[kThreads][3];
  double own[3] = {};
  for (int g = thread_index(); g < pixels; g += kThreads * kSumBlocks) {
    const float scale = d ? d[g] : 1.0f;
    for (int c = 0; c < 3; ++c) own[c] += double(a[3 * std::size_t(g) + c]) * b[3 * std::size_t(g) + c] * scale;
  }
  add_up(sums, own);
  if (threadIdx.x == 0) {
    for (int c = 0; c < 3; ++c) parts[3 * blockIdx.x + c] = sums[0][c];
  }
}

/// x += alpha p, r -= alpha q.
__global__ void advance(int pixels, Rgb3 alpha, const float* p, const float* q, float* x, float* r) {
  const int g = thread_index();
  if (g >= pixels) return;
  for (int c = 0; c < 3; ++c) {
    const std::size_t i = 3 * std::size_t(g) + c;
    x[i] += alpha.v[c] * p[i];
    r[i] -= alpha.v[c] * q[i];
  }
}

/// p = r / D + beta p.
__global__ void turn(int pixels, Rgb3 beta, const float* r, const float* inverse, float* p) {
  const int g = thread_index();
  if (g >= pixels) return;
  for (int c = 0; c < 3; ++c) {
    const std::size_t i = 3 * std::size_t(g) + c;
    p[i] = r[i] * inverse[g] + beta.v[c] * p[i];
  }
}

/// W^2 = scale W0^2 / (|W0 (A x - b)| + epsilon) of RGB norms [Manzi 2016, Eq. 3]; parts[block]: their sum in channel
/// 0.
__global__ void reweight(FlatRows m, SquaredWeights w0, const float* precision, const float* data, const float* x,
                         float epsilon, float scale, float* squared, double* parts) {
  __shared__ double sums[kThreads][3];
  double own[3] = {};
  const int n = m.pixels();
  for (int g = thread_index(); g < n; g += kThreads * kSumBlocks) {
    for (int s = 0; s < kRowSets; ++s) {
      const std::size_t row = std::size_t(s) * n + g;
      if (!m.exists(RowSet(s), g)) {
        squared[row] = 0;
        continue;
      }
      const float square = w0.of[s] * (precision ? precision[row] : 1.0f);
      float sum = 0;
      for (int c = 0; c < 3; ++c) {
        const float r = m.value(RowSet(s), g, x, c) - data[3 * row + c];
        sum += r * r;
      }
      const float norm = sqrtf(square * sum);
      squared[row] = scale * square / (norm + epsilon);
      own[0] += double(norm);
    }
  }
  add_up(sums, own);
  if (threadIdx.x == 0) parts[3 * blockIdx.x] = sums[0][0];
}

}  // namespace kernels

/// A window on the device. Sums are those of the three channels.
class Solver {
 public:
  Solver(const FlatWindow& window, const PoissonSettings& settings)
      : pixels_(int(window.pixels())),
        forward_(window.forward),
        backward_(window.backward),
        mixed_(window.mixed),
        data_(window.data),
        precision_(window.precision),
        squared_(std::size_t(kRowSets) * window.pixels()),
        residual_(3 * std::size_t(kRowSets) * window.pixels()),
        inverse_(window.pixels()),
        x(3 * window.pixels()),
        r_(3 * window.pixels()),
        p_(3 * window.pixels()),
        q_(3 * window.pixels()),
        parts_(3 * kSumBlocks),
        rows_{window.width, window.height, window.frames, forward_.data(), backward_.data(), mixed_.data()} {
    for (int s = 0; s < kRowSets; ++s) {
      const float w = settings.weights.of(RowSet(s));
      w0_.of[s] = w * w;
    }
  }

  void set_weights() {
    kernels::set_weights<<<blocks(), kThreads>>>(rows_, w0_, precision_.data(), squared_.data());
    finish_weights(precision_.data() == nullptr);
  }
  /// Returns the sum of norms.
  double reweight(double epsilon, double scale) {
    kernels::reweight<<<kSumBlocks, kThreads>>>(rows_, w0_, precision_.data(), data_.data(), x.data(), float(epsilon),
                                                float(scale), squared_.data(), parts_.data());
    check(cudaGetLastError());
    const double sum = sum_of_parts()[0];
    finish_weights(false);
    return sum;
  }

  /// As conjugate_gradients of the host (poisson.cpp), with the norm of each residual computed before the next
  /// direction.
  /// [Hestenes 1952]
  int conjugate_gradients(int steps, double& residual, const std::function<void(int)>& before_step) {
    apply(x.data(), data_.data(), -1, r_.data());
    kernels::turn<<<blocks(), kThreads>>>(pixels_, Rgb3{}, r_.data(), inverse_.data(), p_.data());
    ChannelSums norm = dot(r_.data(), r_.data(), inverse_.data());
    const ChannelSums start = norm;
    constexpr double kConverged = 1e-14;  // of squared norms: the limit of single precision
    int taken = 0;
    for (; taken < steps; ++taken) {
      const auto active = [&](std::size_t c) { return norm[c] > kConverged * start[c]; };
      if (!active(0) && !active(1) && !active(2)) break;
      before_step(taken);
      apply(p_.data(), nullptr, 1, q_.data());
      const ChannelSums pq = dot(p_.data(), q_.data(), nullptr);
      Rgb3 alpha{}, beta{};
      for (std::size_t c = 0; c < 3; ++c) alpha.v[c] = active(c) && pq[c] > 0 ? float(norm[c] / pq[c]) : 0.0f;
      kernels::advance<<<blocks(), kThreads>>>(pixels_, alpha, p_.data(), q_.data(), x.data(), r_.data());
      const ChannelSums next = dot(r_.data(), r_.data(), inverse_.data());
      for (std::size_t c = 0; c < 3; ++c) beta.v[c] = alpha.v[c] != 0 ? float(next[c] / norm[c]) : 0.0f;
      kernels::turn<<<blocks(), kThreads>>>(pixels_, beta, r_.data(), inverse_.data(), p_.data());
      norm = next;
    }
    double now = 0, then = 0;
    for (std::size_t c = 0; c < 3; ++c) now += norm[c], then += start[c];
    residual = then > 0 ? std::sqrt(now / then) : 0;
    return taken;
  }

 private:
  int blocks() const { return (pixels_ + kThreads - 1) / kThreads; }
  void apply(const float* from, const float* data, float sign, float* to) {
    kernels::weigh_residuals<<<blocks(), kThreads>>>(rows_, squared_.data(), from, data, residual_.data());
    kernels::transpose<<<blocks(), kThreads>>>(rows_, residual_.data(), sign, to);
    check(cudaGetLastError());
  }
  void finish_weights(bool uniform) {
    kernels::invert_diagonal<<<blocks(), kThreads>>>(rows_, squared_.data(), uniform, inverse_.data());
    check(cudaGetLastError());
  }
  ChannelSums dot(const float* a, const float* b, const float* d) {
    kernels::dot<<<kSumBlocks, kThreads>>>(pixels_, a, b, d, parts_.data());
    check(cudaGetLastError());
    return sum_of_parts();
  }
  ChannelSums sum_of_parts() const {
    std::array<double, 3 * kSumBlocks> parts;
    parts_.download(parts.data());
    ChannelSums sum{};
    for (std::size_t i = 0; i < parts.size(); ++i) sum[i % 3] += parts[i];
    return sum;
  }

  int pixels_;
  DeviceArray<int> forward_, backward_;
  DeviceArray<unsigned char> mixed_;
  DeviceArray<float> data_, precision_, squared_, residual_, inverse_;

 public:
  DeviceArray<float> x;

 private:
  DeviceArray<float> r_, p_, q_;
  DeviceArray<double> parts_;
  FlatRows rows_;
  SquaredWeights w0_{};
};

template <class F>
void for_each_value(PlanarFrames& x, std::vector<float>& flat, F&& f) {
  std::size_t i = 0;
  for (int t = 0; t < x.frames(); ++t) {
    for (int y = 0; y < x.height(); ++y) {
      float* const rows[3] = {x.row(t, y, 0), x.row(t, y, 1), x.row(t, y, 2)};
      for (int k = 0; k < x.width(); ++k) {
        for (int c = 0; c < 3; ++c) f(rows[c][k], flat[i++]);
      }
    }
  }
}

}  // namespace

int cuda_device_count() {
  int count = 0;
  return cudaGetDeviceCount(&count) == cudaSuccess ? count : 0;
}

void solve_rounds_on_cuda(const FlatWindow& window, const PoissonSettings& settings, int first_round, double unit,
                          PlanarFrames& x, PoissonReport& report, const std::function<void(int, int)>& before_step) {
  const bool l1 = settings.norm == PoissonNorm::kL1;
  const int rounds = l1 ? settings.rounds : 1, steps = l1 ? settings.round_steps : settings.l2_steps;
  Solver solver(window, settings);
  std::vector<float> flat(3 * window.pixels());
  for_each_value(x, flat, [](float from, float& to) { to = from; });
  solver.x.upload(flat.data());
  for (int round = first_round; round < rounds; ++round) {
    if (round == 0) {
      solver.set_weights();
    } else {
      const double epsilon = unit * std::max(settings.epsilon_floor, settings.epsilon * std::exp2(1 - round));
      report.objective = solver.reweight(epsilon, unit);
    }
    report.steps += solver.conjugate_gradients(steps, report.residual, [&](int step) { before_step(round, step); });
  }
  solver.x.download(flat.data());
  for_each_value(x, flat, [](float& to, float from) { to = from; });
}

}  // namespace tempera
