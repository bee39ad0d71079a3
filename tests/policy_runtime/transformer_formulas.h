#pragma once

#include <random>
#include <string>
#include <vector>

#include "policy_runtime/policy_file.h"

/// The transformer of ACT and of the flow field in double precision, written down formula by
/// formula: nothing is computed ahead, stacked or shared with the runtime.
namespace tandem::policy::testing {

using Matrix = std::vector<std::vector<double>>;  ///< rows

struct TransformerSpec {
  int model_size = 6;
  int heads = 3;
  int feedforward = 7;
  int encoder_layers = 2;
  int decoder_layers = 1;
  std::string activation = "relu";
};

/// Adds random tensors of a map, a norm, an attention, encoder layers and decoder layers.
void add_linear(PolicyFile& file, const std::string& prefix, int in, int out, std::mt19937& random);
void add_norm(PolicyFile& file, const std::string& prefix, int n, std::mt19937& random);
void add_encoder_layer(PolicyFile& file, const std::string& prefix, const TransformerSpec& spec,
                       std::mt19937& random);
void add_decoder_layer(PolicyFile& file, const std::string& prefix, const TransformerSpec& spec,
                       std::mt19937& random);

/// Cuts the lower halves of its values off, as its file will.
void round_to_bfloat16(Tensor& tensor);

/// A tensor of rank 2.
Matrix matrix(const PolicyFile& file, const std::string& name);

Matrix sum(Matrix a, const Matrix& b);

/// X W' + b; PREFIX.weight, PREFIX.bias.
Matrix linear(const PolicyFile& file, const std::string& prefix, const Matrix& X);

/// PREFIX.scale, PREFIX.offset; epsilon 1e-5.
Matrix norm(const PolicyFile& file, const std::string& prefix, Matrix X);

/// With output projection.
Matrix attention(const PolicyFile& file, const std::string& prefix, int heads,
                 const Matrix& queries, const Matrix& keys, const Matrix& values);

Matrix encoder_layer(const PolicyFile& file, const std::string& prefix, const TransformerSpec& spec,
                     const Matrix& X, const Matrix& positions);
Matrix decoder_layer(const PolicyFile& file, const std::string& prefix, const TransformerSpec& spec,
                     const Matrix& X, const Matrix& positions, const Matrix& memory,
                     const Matrix& memory_positions);

}  // namespace tandem::policy::testing
