#include "policy_runtime/layers/transformer.h"

#include <gtest/gtest.h>

#include <cmath>

#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/layers/encoder.h"
#include "policy_runtime/transformer_formulas.h"

namespace tandem::policy::testing {
namespace {

const TransformerSpec kSpecs[] = {
    {.model_size = 6, .heads = 3, .feedforward = 7},
    {.model_size = 1, .heads = 1, .feedforward = 1, .activation = "gelu"},
    {.model_size = 17, .heads = 1, .feedforward = 33, .activation = "gelu"},
    {.model_size = 32, .heads = 4, .feedforward = 16},
    {.model_size = 70, .heads = 7, .feedforward = 19},
};

TransformerConfig config_of(const TransformerSpec& spec) {
  return {spec.model_size, spec.heads, spec.feedforward,
          spec.activation == "relu" ? Activation::kRelu : Activation::kGelu};
}

Matrix random_matrix(int n, int d, std::mt19937& random) {
  std::normal_distribution<float> normal;
  Matrix rows(n, std::vector<double>(d));
  for (auto& row : rows) {
    for (double& value : row) value = normal(random);
  }
  return rows;
}

PositionRows rows_of(const Matrix& matrix) {
  std::vector<float> values;
  for (const auto& row : matrix) values.insert(values.end(), row.begin(), row.end());
  return {values, static_cast<int>(matrix.size()), static_cast<int>(matrix[0].size())};
}

// Memory for n rows of d numbers whose old content must not matter.
struct DirtyRows {
  AlignedBuffer buffer;
  Rows rows;

  DirtyRows(int n, int d) : buffer(n * padded(d)), rows{buffer.data(), padded(d)} {
    std::fill_n(buffer.data(), buffer.size(), std::nanf(""));
  }
};

AlignedBuffer dirty(std::size_t size) {
  AlignedBuffer buffer(size);
  std::fill_n(buffer.data(), buffer.size(), std::nanf(""));
  return buffer;
}

void expect_rows(const Rows& rows, const Matrix& expected, const std::string& what) {
  const std::size_t d = expected[0].size();
  for (std::size_t i = 0; i < expected.size(); ++i) {
    const float* row = rows.data + i * rows.stride;
    for (std::size_t c = 0; c < d; ++c) ASSERT_NEAR(row[c], expected[i][c], 1e-5) << what;
    for (std::size_t c = d; c < padded(d); ++c) ASSERT_EQ(row[c], 0.0f) << what << " padding";
  }
}

// f(kernel set, name) under every kernel; what is computed at load uses the same one.
template <typename F>
void under_every_kernel(F f) {
  for (const std::string& name : available_kernels()) {
    force_kernel(name);
    f(kernels(), name);
  }
  force_kernel("simd");
}

TEST(EncoderLayer, AgreesWithTheFormula) {
  std::mt19937 random(1);
  for (const TransformerSpec& spec : kSpecs) {
    for (const int n : {1, 2, 13}) {
      const int d = spec.model_size;
      PolicyFile tensors;
      add_encoder_layer(tensors, "layer", spec, random);
      const Matrix x = random_matrix(n, d, random), positions = random_matrix(n, d, random);
      const Matrix expected = encoder_layer(tensors, "layer", spec, x, positions);
      const PositionRows X = rows_of(x);
      const std::string path = write_file(tensors);
      under_every_kernel([&](const Kernels& kernels, const std::string& name) {
        SafetensorsFile file(path);
        const EncoderLayer layer(file, "layer", config_of(spec), rows_of(positions));
        file.refuse_unused();
        DirtyRows qkv(n, 3 * d), y(n, d);
        AlignedBuffer workspace = dirty(layer.workspace_size());
        layer.projection().forward(kernels, X, n, qkv.rows);
        layer.forward(kernels, X, qkv.rows, y.rows, workspace.data());
        expect_rows(y.rows, expected, name);
      });
    }
  }
}

TEST(DecoderLayer, AgreesWithTheFormulaForEverySample) {
  constexpr int kSamples = 3;
  std::mt19937 random(2);
  for (const TransformerSpec& spec : kSpecs) {
    for (const int queries : {1, 5}) {
      const int d = spec.model_size, tokens = 4, n = kSamples * queries;
      PolicyFile tensors;
      add_decoder_layer(tensors, "layer", spec, random);
      const Matrix memory = random_matrix(tokens, d, random);
      const Matrix memory_positions = random_matrix(tokens, d, random);
      const Matrix positions = random_matrix(queries, d, random), x = random_matrix(n, d, random);
      Matrix expected;
      for (auto sample = x.begin(); sample != x.end(); sample += queries) {
        const Matrix y = decoder_layer(tensors, "layer", spec, {sample, sample + queries},
                                       positions, memory, memory_positions);
        expected.insert(expected.end(), y.begin(), y.end());
      }
      const PositionRows X = rows_of(x), M = rows_of(memory);
      const std::string path = write_file(tensors);
      under_every_kernel([&](const Kernels& kernels, const std::string& name) {
        SafetensorsFile file(path);
        const DecoderLayer layer(file, "layer", config_of(spec), rows_of(positions),
                                 rows_of(memory_positions));
        file.refuse_unused();
        DirtyRows qkv(n, 3 * d), kv(tokens, 2 * d), y(n, d);
        AlignedBuffer workspace = dirty(layer.workspace_size(kSamples));
        for (int i = 0; i < n; i += queries) {
          layer.projection().forward(kernels, {ConstRows(X).data + i * padded(d), padded(d)},
                                     queries,
                                     {qkv.rows.data + i * qkv.rows.stride, qkv.rows.stride});
        }
        layer.memory_projection().forward(kernels, M, tokens, kv.rows);
        layer.forward(kernels, X, qkv.rows, kv.rows, kSamples, y.rows, workspace.data());
        expect_rows(y.rows, expected, name);
      });
    }
  }
}

TEST(FirstDecoderLayer, IsTheDecoderLayerOfZeros) {
  std::mt19937 random(3);
  for (const TransformerSpec& spec : kSpecs) {
    const int d = spec.model_size, queries = 5, tokens = 3;
    PolicyFile tensors;
    add_decoder_layer(tensors, "layer", spec, random);
    const Matrix memory = random_matrix(tokens, d, random);
    const Matrix memory_positions = random_matrix(tokens, d, random);
    const Matrix positions = random_matrix(queries, d, random);
    const Matrix zeros(queries, std::vector<double>(d));
    const Matrix expected =
        decoder_layer(tensors, "layer", spec, zeros, positions, memory, memory_positions);
    const std::string path = write_file(tensors);
    under_every_kernel([&](const Kernels& kernels, const std::string& name) {
      SafetensorsFile file(path);
      const FirstDecoderLayer layer(file, "layer", config_of(spec), rows_of(positions),
                                    rows_of(memory_positions));
      file.refuse_unused();
      DirtyRows kv(tokens, 2 * d), y(queries, d);
      AlignedBuffer workspace = dirty(layer.workspace_size());
      layer.memory_projection().forward(kernels, rows_of(memory), tokens, kv.rows);
      layer.forward(kernels, kv.rows, y.rows, workspace.data());
      expect_rows(y.rows, expected, name);
    });
  }
}

// Tokens of numbers and given features, with layers and without.
TEST(Encoder, AgreesWithTheFormula) {
  std::mt19937 random(4);
  for (const TransformerSpec& spec : kSpecs) {
    for (const int layers : {0, 1, 3}) {
      const int d = spec.model_size, features = 2;
      const std::vector<Encoder::Token> tokens = {{"a", 5}, {"b", 20}};
      PolicyFile tensors;
      for (const auto& [name, size] : tokens) add_linear(tensors, name, size, d, random);
      for (int l = 0; l < layers; ++l) {
        add_encoder_layer(tensors, "encoder." + std::to_string(l), spec, random);
      }
      const Matrix a = random_matrix(1, 5, random), positions = random_matrix(4, d, random);
      Matrix x = random_matrix(features, d, random);
      const PositionRows given = rows_of(x);
      x.insert(x.begin(), linear(tensors, "b", {std::vector<double>(20)})[0]);
      x.insert(x.begin(), linear(tensors, "a", a)[0]);
      for (int l = 0; l < layers; ++l) {
        x = encoder_layer(tensors, "encoder." + std::to_string(l), spec, x, positions);
      }
      const std::string path = write_file(tensors);
      under_every_kernel([&](const Kernels& kernels, const std::string& name) {
        SafetensorsFile file(path);
        const Encoder encoder(file, "encoder", config_of(spec), layers, tokens, rows_of(positions));
        file.refuse_unused();
        ASSERT_EQ(encoder.tokens(), 4);
        DirtyRows first(4, static_cast<int>(encoder.row_stride())), memory(4, d);
        AlignedBuffer workspace = dirty(encoder.workspace_size());
        encoder.embed(kernels, 0, ConstRows(rows_of(a)).data, first.rows);
        encoder.embed_zeros(1, first.rows);
        for (int i = 0; i < features; ++i) {
          std::copy_n(ConstRows(given).data + i * padded(d), padded(d),
                      first.rows.data + (2 + i) * first.rows.stride);
        }
        encoder.embed_features(kernels, first.rows);
        encoder.forward(kernels, first.rows, memory.rows, workspace.data());
        expect_rows(memory.rows, x, name);
      });
    }
  }
}

}  // namespace
}  // namespace tandem::policy::testing
