#include "policy_runtime/layers/split_perceptron.h"

#include <gtest/gtest.h>

#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/head_formulas.h"

namespace tandem::policy::testing {
namespace {

std::vector<Kernels> all_kernels() {
  std::vector<Kernels> all = simd_kernels();
  all.push_back(scalar_kernels());
  return all;
}

AlignedBuffer rows(const std::vector<float>& values, int n, int columns) {
  AlignedBuffer buffer(n * padded(columns));
  for (int i = 0; i < n; ++i) {
    std::copy_n(values.data() + i * columns, columns, buffer.data() + i * padded(columns));
  }
  return buffer;
}

struct Case {
  PerceptronSpec spec;
  int members, x, a, out, n;
  std::vector<std::vector<double>> known = {};
};

const Case kCases[] = {
    {{.hidden = {}}, 1, 1, 1, 1, 1},
    {{.hidden = {}}, 3, 5, 17, 33, 4, {{0.5}, {-2.0}}},
    {{.hidden = {19, 33}}, 1, 7, 6, 6, 1, {{0.5, 2.0, -1.0, 3.0}, {1.0, 0.0, 0.5, -0.5}}},
    {{.hidden = {16}, .activation = "tanh"}, 5, 40, 28, 1, 8},
    {{.hidden = {21, 10, 65}, .activation = "gelu", .layer_norm = true}, 4, 13, 31, 3, 7},
    {{.hidden = {1}, .layer_norm = true}, 2, 3, 2, 2, 5},
};

TEST(SplitPerceptron, AgreesWithWholePerceptronsInDoublePrecision) {
  for (const Case& c : kCases) {
    std::mt19937 random(1);
    const std::size_t n_known = c.known.empty() ? 0 : c.known.front().size();
    PolicyFile file;
    std::vector<std::string> names;
    for (int m = 0; m < c.members; ++m) {
      names.push_back("net." + std::to_string(m));
      add_perceptron(file, names.back(), c.spec, c.x + c.a + int(n_known), c.out, random);
    }
    SafetensorsFile tensors(write_file(file));
    Perceptron::Config config{c.spec.hidden, {}, c.spec.layer_norm};
    ASSERT_TRUE(activation_from_name(c.spec.activation, config.activation));
    const SplitPerceptron net(tensors, names, config, {c.x, c.a, c.known}, c.out);
    tensors.refuse_unused();

    const auto x = random_numbers(c.x, 1.0f, random), a = random_numbers(c.n * c.a, 1.0f, random);
    const AlignedBuffer X = rows(x, 1, c.x), A = rows(a, c.n, c.a);
    const std::size_t width = net.first().width(), stride = c.members * padded(c.out);
    for (const Kernels& kernels : all_kernels()) {
      AlignedBuffer base(width), shifted(width), Y(c.n * stride), scratch(net.workspace_size(c.n));
      net.first().observe(kernels, X.data(), base.data());
      for (std::size_t k = 0; k < std::max<std::size_t>(1, c.known.size()); ++k) {
        if (!c.known.empty()) net.first().shift(base.data(), int(k), shifted.data());
        net.forward(kernels, c.known.empty() ? base.data() : shifted.data(),
                    {A.data(), padded(c.a)}, c.n, {Y.data(), stride}, scratch.data());
        for (int row = 0; row < c.n; ++row) {
          std::vector<double> input(x.begin(), x.end());
          input.insert(input.end(), a.begin() + row * c.a, a.begin() + (row + 1) * c.a);
          if (n_known) input.insert(input.end(), c.known[k].begin(), c.known[k].end());
          for (int m = 0; m < c.members; ++m) {
            const auto expected = evaluate(file, names[m], c.spec, input);
            const float* y = Y.data() + row * stride + m * padded(c.out);
            for (int i = 0; i < c.out; ++i) ASSERT_NEAR(y[i], expected[i], 1e-5) << kernels.name;
            for (std::size_t i = c.out; i < padded(c.out); ++i) ASSERT_EQ(y[i], 0.0f) << "padding";
          }
        }
      }
    }
  }
}

}  // namespace
}  // namespace tandem::policy::testing
