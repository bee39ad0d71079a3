#include "policy_runtime/layers/convolution.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <span>

#include "policy_runtime/vision_file.h"

namespace tandem::policy {
namespace {

using Method = Convolution::Method;

constexpr float kGarbage = 1e30f;  // in memory that must not be read before it is written

std::vector<Kernels> all_kernels() {
  std::vector<Kernels> all = simd_kernels();
  all.push_back(scalar_kernels());
  return all;
}

struct Problem {
  ConvolutionShape shape;
  int height, width;
  bool residual;
};

// Runs one random convolution in memory of exactly the counted size and compares every number of
// the output map with the formula; a frame around the output must stay as it was.
void expect_formula(const Problem& problem, Method method, const Kernels& kernels,
                    std::mt19937& random) {
  const ConvolutionShape& shape = problem.shape;
  const auto uniform = [&] { return std::uniform_real_distribution<float>(-1.0f, 1.0f)(random); };
  const int k = shape.kernel, O = shape.out_channels, C = shape.in_channels;

  testing::Volume x{problem.height, problem.width, C, {}};
  x.values.resize(std::size_t(x.height) * x.width * C);
  for (double& value : x.values) value = uniform();
  ConvolutionWeights weights;
  weights.weight.resize(std::size_t(O) * C * k * k);
  for (float& value : weights.weight) value = uniform();
  for (int o = 0; o < O; ++o) {
    weights.scale.push_back(0.5 + 0.4 * uniform());
    weights.bias.push_back(double(uniform()));
  }

  const MapShape in{x.height, x.width, C, shape.padding(), C == 3 ? 3 : padded(C)};
  AlignedBuffer in_memory(in.size());
  std::fill_n(in_memory.data(), in_memory.size(), kGarbage);
  in.clear_frame(in_memory.data());
  for (int y = 0; y < x.height; ++y) {
    for (int i = 0; i < x.width; ++i) {
      float* pixel = in.at(in_memory.data()).pixel(y, i);
      std::fill_n(pixel, in.pixel_stride, 0.0f);
      for (int c = 0; c < C; ++c) pixel[c] = float(x.at(y, i, c));
    }
  }
  const MapShape out{shape.out_side(x.height), shape.out_side(x.width), O, 1, padded(O)};
  AlignedBuffer out_memory(out.size()), added_memory(out.size());
  std::fill_n(out_memory.data(), out_memory.size(), kGarbage);
  for (float& value : std::span(added_memory.data(), added_memory.size())) value = uniform();
  const Map residual = problem.residual ? out.at(added_memory.data()) : Map{};

  const Convolution convolution(weights, shape, in, method);
  AlignedBuffer workspace(convolution.workspace_size());
  std::fill_n(workspace.data(), workspace.size(), kGarbage);
  convolution.forward(kernels, in.at(in_memory.data()), residual, out.at(out_memory.data()),
                      workspace.data());

  const testing::Volume sums = testing::convolve(x, {{O, C, k, k}, weights.weight}, shape.stride);
  ASSERT_EQ(sums.height, out.height);
  ASSERT_EQ(sums.width, out.width);
  const Map result = out.at(out_memory.data());
  for (int y = -1; y <= out.height; ++y) {
    for (int i = -1; i <= out.width; ++i) {
      const bool inside = y >= 0 && y < out.height && i >= 0 && i < out.width;
      for (int c = 0; c < int(out.pixel_stride); ++c) {
        double expected = kGarbage;
        if (inside) {
          expected = c < O ? weights.scale[c] * sums.at(y, i, c) + weights.bias[c] : 0.0;
          if (problem.residual) expected += residual.pixel(y, i)[c];
          if (shape.relu) expected = std::fmax(expected, 0.0);
        }
        ASSERT_NEAR(result.pixel(y, i)[c], expected, 4e-7 * (k * k * C + 10))
            << kernels.name << (method == Method::kDirect ? " direct " : " Winograd ") << x.height
            << " x " << x.width << " kernel " << k << " stride " << shape.stride << " channels "
            << C << " -> " << O << " at " << y << ", " << i << ", " << c;
      }
    }
  }
}

TEST(Convolution, DirectAgreesWithTheFormulaAtOddSizes) {
  std::mt19937 random(1);
  const int sides[] = {1, 2, 3, 5, 8, 13, 17}, channels[] = {1, 3, 16, 17, 33};
  const auto any = [&](const auto& list) { return list[random() % std::size(list)]; };
  for (const Kernels& kernels : all_kernels()) {
    for (const int kernel : {1, 3, 5, 7}) {
      for (const int stride : {1, 2, 3, 4}) {
        for (int i = 0; i < 6; ++i) {
          const ConvolutionShape shape{any(channels), any(channels), kernel, stride, i % 2 == 0};
          expect_formula({shape, any(sides), any(sides), i % 3 == 0}, Method::kDirect, kernels,
                         random);
        }
      }
    }
  }
}

TEST(Convolution, WinogradAgreesWithTheFormulaAtOddSizes) {
  std::mt19937 random(2);
  const int channels[] = {1, 16, 17, 33};
  for (const Kernels& kernels : all_kernels()) {
    for (int height = 1; height <= 17; ++height) {
      for (const int width : {1, 2, 3, 6, 9, 16, 17}) {
        const int i = height + width;
        const ConvolutionShape shape{channels[i % 4], channels[i * 3 % 4], 3, 1, i % 2 == 0};
        expect_formula({shape, height, width, i % 3 == 0}, Method::kWinograd, kernels, random);
      }
    }
  }
}

// Several strips, the last one shorter.
TEST(Convolution, StripsMeetWithoutSeam) {
  std::mt19937 random(3);
  for (const Method method : {Method::kDirect, Method::kWinograd}) {
    expect_formula({{48, 32, 3, 1, true}, 31, 37, true}, method, kernels(), random);
  }
}

// Networks add in place: the residual's memory becomes the output's.
TEST(Convolution, ResidualMayBeTheOutput) {
  std::mt19937 random(4);
  std::uniform_real_distribution<float> uniform(-1.0f, 1.0f);
  const MapShape map{7, 9, 32, 1, 32};
  ConvolutionWeights weights{std::vector<float>(32 * 32 * 9), std::vector<double>(32, 1.0),
                             std::vector<double>(32, 0.0)};
  for (float& value : weights.weight) value = uniform(random);
  for (const Method method : {Method::kDirect, Method::kWinograd}) {
    const Convolution convolution(weights, {32, 32, 3, 1, true}, map, method);
    AlignedBuffer in(map.size()), apart(map.size()), out(map.size());
    AlignedBuffer workspace(convolution.workspace_size());
    for (std::size_t i = 0; i < map.size(); ++i) {
      in.data()[i] = uniform(random);
      apart.data()[i] = uniform(random);
    }
    map.clear_frame(in.data());
    map.clear_frame(apart.data());
    convolution.forward(kernels(), map.at(in.data()), map.at(apart.data()), map.at(out.data()),
                        workspace.data());
    convolution.forward(kernels(), map.at(in.data()), map.at(apart.data()), map.at(apart.data()),
                        workspace.data());
    for (std::size_t i = 0; i < map.size(); ++i) ASSERT_EQ(apart.data()[i], out.data()[i]) << i;
  }
}

}  // namespace
}  // namespace tandem::policy
