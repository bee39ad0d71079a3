#include "policy_runtime/transformer_formulas.h"

#include <bit>
#include <cmath>

namespace tandem::policy::testing {
namespace {

void add_attention(PolicyFile& file, const std::string& prefix, int d, std::mt19937& random) {
  for (const std::string part : {"query", "key", "value", "output"}) {
    add_linear(file, prefix + "." + part, d, d, random);
  }
}

void add_feedforward(PolicyFile& file, const std::string& prefix, const TransformerSpec& spec,
                     std::mt19937& random) {
  add_linear(file, prefix + ".feedforward1", spec.model_size, spec.feedforward, random);
  add_linear(file, prefix + ".feedforward2", spec.feedforward, spec.model_size, random);
}

Matrix feedforward(const PolicyFile& file, const std::string& prefix, const TransformerSpec& spec,
                   const Matrix& X) {
  Matrix hidden = linear(file, prefix + ".feedforward1", X);
  for (auto& row : hidden) {
    for (double& v : row) {
      if (spec.activation == "relu") {
        v = v > 0 ? v : 0;
      } else {
        v = 0.5 * v * (1 + std::tanh(std::sqrt(2 / M_PI) * (v + 0.044715 * v * v * v)));
      }
    }
  }
  return linear(file, prefix + ".feedforward2", hidden);
}

}  // namespace

void add_linear(PolicyFile& file, const std::string& prefix, int in, int out,
                std::mt19937& random) {
  file.tensors[prefix + ".weight"] =
      random_tensor({out, in}, 0.0f, 1.0f / std::sqrt(float(in)), random);
  file.tensors[prefix + ".bias"] = random_tensor({out}, 0.0f, 0.3f, random);
}

void add_norm(PolicyFile& file, const std::string& prefix, int n, std::mt19937& random) {
  file.tensors[prefix + ".scale"] = random_tensor({n}, 1.0f, 0.2f, random);
  file.tensors[prefix + ".offset"] = random_tensor({n}, 0.0f, 0.2f, random);
}

void add_encoder_layer(PolicyFile& file, const std::string& prefix, const TransformerSpec& spec,
                       std::mt19937& random) {
  add_attention(file, prefix + ".attention", spec.model_size, random);
  add_feedforward(file, prefix, spec, random);
  for (const std::string name : {".norm1", ".norm2"}) {
    add_norm(file, prefix + name, spec.model_size, random);
  }
}

void add_decoder_layer(PolicyFile& file, const std::string& prefix, const TransformerSpec& spec,
                       std::mt19937& random) {
  add_attention(file, prefix + ".self_attention", spec.model_size, random);
  add_attention(file, prefix + ".cross_attention", spec.model_size, random);
  add_feedforward(file, prefix, spec, random);
  for (const std::string name : {".norm1", ".norm2", ".norm3"}) {
    add_norm(file, prefix + name, spec.model_size, random);
  }
}

void round_to_bfloat16(Tensor& tensor) {
  tensor.dtype = "BF16";
  for (float& value : tensor.values) {
    value = std::bit_cast<float>(std::bit_cast<std::uint32_t>(value) & 0xffff0000u);
  }
}

Matrix matrix(const PolicyFile& file, const std::string& name) {
  const Tensor& tensor = file.tensors.at(name);
  const std::int64_t columns = tensor.shape.at(1);
  Matrix rows;
  for (auto row = tensor.values.begin(); row != tensor.values.end(); row += columns) {
    rows.emplace_back(row, row + columns);
  }
  return rows;
}

Matrix sum(Matrix a, const Matrix& b) {
  for (std::size_t i = 0; i < a.size(); ++i) {
    for (std::size_t c = 0; c < a[i].size(); ++c) a[i][c] += b[i][c];
  }
  return a;
}

Matrix linear(const PolicyFile& file, const std::string& prefix, const Matrix& X) {
  const Matrix W = matrix(file, prefix + ".weight");
  const auto found = file.tensors.find(prefix + ".bias");
  Matrix Y;
  for (const auto& x : X) {
    std::vector<double> y(W.size());
    for (std::size_t row = 0; row < W.size(); ++row) {
      if (found != file.tensors.end()) y[row] = found->second.values[row];
      for (std::size_t c = 0; c < x.size(); ++c) y[row] += W[row][c] * x[c];
    }
    Y.push_back(y);
  }
  return Y;
}

Matrix norm(const PolicyFile& file, const std::string& prefix, Matrix X) {
  const Tensor& scale = file.tensors.at(prefix + ".scale");
  const Tensor& offset = file.tensors.at(prefix + ".offset");
  for (auto& x : X) {
    double mean = 0, variance = 0;
    for (const double v : x) mean += v / x.size();
    for (const double v : x) variance += (v - mean) * (v - mean) / x.size();
    for (std::size_t i = 0; i < x.size(); ++i) {
      x[i] = (x[i] - mean) / std::sqrt(variance + 1e-5) * scale.values[i] + offset.values[i];
    }
  }
  return X;
}

Matrix attention(const PolicyFile& file, const std::string& prefix, int heads,
                 const Matrix& queries, const Matrix& keys, const Matrix& values) {
  const Matrix Q = linear(file, prefix + ".query", queries);
  const Matrix K = linear(file, prefix + ".key", keys);
  const Matrix V = linear(file, prefix + ".value", values);
  const std::size_t d = Q[0].size(), size = d / heads;
  Matrix out(Q.size(), std::vector<double>(d));
  for (std::size_t begin = 0; begin < d; begin += size) {
    for (std::size_t i = 0; i < Q.size(); ++i) {
      double total = 0;
      std::vector<double> weight(K.size());
      for (std::size_t j = 0; j < K.size(); ++j) {
        double score = 0;
        for (std::size_t c = begin; c < begin + size; ++c) score += Q[i][c] * K[j][c];
        total += weight[j] = std::exp(score / std::sqrt(double(size)));
      }
      for (std::size_t j = 0; j < K.size(); ++j) {
        for (std::size_t c = begin; c < begin + size; ++c) out[i][c] += weight[j] / total * V[j][c];
      }
    }
  }
  return linear(file, prefix + ".output", out);
}

Matrix encoder_layer(const PolicyFile& file, const std::string& prefix, const TransformerSpec& spec,
                     const Matrix& X, const Matrix& positions) {
  const Matrix with_positions = sum(X, positions);
  Matrix x =
      sum(X, attention(file, prefix + ".attention", spec.heads, with_positions, with_positions, X));
  x = norm(file, prefix + ".norm1", x);
  return norm(file, prefix + ".norm2", sum(x, feedforward(file, prefix, spec, x)));
}

Matrix decoder_layer(const PolicyFile& file, const std::string& prefix, const TransformerSpec& spec,
                     const Matrix& X, const Matrix& positions, const Matrix& memory,
                     const Matrix& memory_positions) {
  const Matrix with_positions = sum(X, positions);
  Matrix x = sum(X, attention(file, prefix + ".self_attention", spec.heads, with_positions,
                              with_positions, X));
  x = norm(file, prefix + ".norm1", x);
  x = sum(x, attention(file, prefix + ".cross_attention", spec.heads, sum(x, positions),
                       sum(memory, memory_positions), memory));
  x = norm(file, prefix + ".norm2", x);
  return norm(file, prefix + ".norm3", sum(x, feedforward(file, prefix, spec, x)));
}

}  // namespace tandem::policy::testing
