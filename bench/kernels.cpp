// What the kernels of the policy runtime reach on this machine, at the shapes of its networks:
// arithmetic and how fast the weights are read. Best of many short slices, so that a busy machine
// shows up little.
#include "policy_runtime/kernels/kernels.h"

#include <time.h>

#include <algorithm>
#include <cstdio>
#include <functional>
#include <limits>
#include <random>
#include <string>
#include <vector>

namespace {
using namespace tandem::policy;  // NOLINT: a program

AlignedBuffer random_buffer(std::size_t floats) {
  static std::mt19937 random(1);
  std::uniform_real_distribution<float> uniform(-1.0f, 1.0f);
  AlignedBuffer buffer(floats);
  std::generate_n(buffer.data(), buffer.size(), [&] { return uniform(random); });
  return buffer;
}

/// Seconds of this thread in one call: the best of 100 slices of about 1 ms.
double seconds(const std::function<void()>& call) {
  const auto now = [] {
    timespec time;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return double(time.tv_sec) + 1e-9 * double(time.tv_nsec);
  };
  const auto run = [&](int calls) {
    const double begin = now();
    for (int i = 0; i < calls; ++i) call();
    return now() - begin;
  };
  run(1);
  const int calls = std::max(1, static_cast<int>(1e-3 / run(1)));
  double best = std::numeric_limits<double>::infinity();
  for (int slice = 0; slice < 100; ++slice) best = std::min(best, run(calls) / calls);
  return best;
}

void print(const std::string& what, double time, double flops, double bytes) {
  std::printf("%-8s %-36s %10.2f us", kernel_name().c_str(), what.c_str(), 1e6 * time);
  if (flops > 0) std::printf(" %8.1f GFLOP/s", 1e-9 * flops / time);
  if (bytes > 0) std::printf(" %7.1f GB/s of weights", 1e-9 * bytes / time);
  std::printf("\n");
}

/// `layers` matrices (out, in) one after the other, so that together they can exceed a cache. n = 0
/// is gemv.
void measure_matrix(int n, int in, int out, int layers, Precision precision) {
  std::vector<AlignedBuffer> memory;
  std::vector<PackedMatrix> matrices;
  for (int layer = 0; layer < layers; ++layer) {
    matrices.push_back({out, in, precision});
    memory.emplace_back(matrices.back().floats());
    pack(random_buffer(std::size_t(in) * out).data(), matrices.back(), memory.back().data());
  }
  const int rows = std::max(n, 1);
  const AlignedBuffer X = random_buffer(rows * padded(in)), bias = random_buffer(padded(out));
  AlignedBuffer Y(rows * padded(out));
  const double time = seconds([&] {
    for (const PackedMatrix& W : matrices) {
      if (n == 0) {
        kernels().gemv(W, bias.data(), X.data(), Y.data());
      } else {
        kernels().gemm(W, {bias.data(), 0}, {X.data(), padded(in)}, n, {Y.data(), padded(out)});
      }
    }
  });
  const bool half = precision == Precision::kBfloat16;
  const std::string name = (n == 0 ? "gemv" : "gemm " + std::to_string(n) + " rows") + ", " +
                           std::to_string(in) + " -> " + std::to_string(out) +
                           (half ? " bf16" : "") + " x " + std::to_string(layers);
  print(name, time, 2.0 * rows * in * out * layers, double(in) * out * layers * (half ? 2 : 4));
}

void measure_attention(const AttentionShape& shape) {
  const std::size_t width = padded(shape.heads * shape.head_size);
  const AlignedBuffer Q = random_buffer(shape.n_queries * width);
  const AlignedBuffer K = random_buffer(shape.n_keys * width);
  const AlignedBuffer V = random_buffer(shape.n_keys * width);
  AlignedBuffer out(shape.n_queries * width), scratch(shape.scratch());
  const double time = seconds([&] {
    kernels().attention(shape, {Q.data(), width}, {K.data(), width}, {V.data(), width},
                        {out.data(), width}, scratch.data());
  });
  print("attention " + std::to_string(shape.n_queries) + " x " + std::to_string(shape.n_keys) +
            ", " + std::to_string(shape.heads) + " heads of " + std::to_string(shape.head_size),
        time, 4.0 * shape.n_queries * shape.n_keys * shape.heads * shape.head_size, 0);
}

void measure_rows(int n, int size) {
  AlignedBuffer y = random_buffer(n * padded(size)), ones = random_buffer(padded(size));
  const auto each_row = [&](auto&& f) {
    for (int i = 0; i < n; ++i) f(y.data() + i * padded(size));
  };
  const std::string shape = " " + std::to_string(n) + " x " + std::to_string(size);
  print("layer_norm" + shape, seconds([&] {
          each_row([&](float* row) {
            kernels().layer_norm(ones.data(), ones.data(), 1e-5f, row, size);
          });
        }),
        0, 0);
  for (const auto& [name, f] :
       {std::pair{"relu", Activation::kRelu}, std::pair{"gelu", Activation::kGelu}}) {
    print(name + shape,
          seconds([&] { each_row([&](float* row) { kernels().activate(f, row, size); }); }), 0, 0);
  }
}

}  // namespace

int main() {
  for (const Precision precision : {Precision::kFloat32, Precision::kBfloat16}) {
    for (const int layers : {1, 4, 64}) measure_matrix(0, 512, 512, layers, precision);
    for (const int n : {1, 2, 8, 16}) measure_matrix(n, 512, 512, 64, precision);
    for (const int n : {8, 16, 51, 100}) measure_matrix(n, 512, 512, 1, precision);
    for (const int n : {16, 100}) measure_matrix(n, 512, 3200, 1, precision);
    for (const int n : {16, 100}) measure_matrix(n, 3200, 512, 1, precision);
  }
  measure_matrix(9216, 27, 32, 1, Precision::kFloat32);  // convolutions
  measure_matrix(4800, 147, 64, 1, Precision::kFloat32);
  measure_matrix(4800, 576, 64, 1, Precision::kFloat32);
  measure_matrix(1200, 1152, 128, 1, Precision::kFloat32);
  measure_matrix(300, 2304, 256, 1, Precision::kFloat32);
  measure_matrix(80, 4608, 512, 1, Precision::kFloat32);
  measure_attention({1, 50, 8, 64});
  measure_attention({16, 3, 4, 32});
  measure_attention({51, 51, 8, 64});
  measure_attention({100, 102, 8, 64});
  measure_attention({100, 200, 8, 64});
  measure_rows(100, 512);
}
