#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "policy/policy_tensors.h"

/// The layers as one would write them down with Eigen: no preparation but batch norm folded into
/// the convolution, as every export does. A batch or a sequence is a matrix with one column each.
namespace tandem::bench {

using Eigen::MatrixXf;
using Eigen::VectorXf;

enum class Activation { identity, relu, tanh, gelu };
Activation activation(const std::string& name);
MatrixXf activate(Activation f, const MatrixXf& x);

MatrixXf matrix(const PolicyTensors& file, const std::string& name);  ///< of two axes
VectorXf vector(const PolicyTensors& file, const std::string& name);  ///< all values in a row

/// y = W x + b.
struct Dense {
  MatrixXf W;
  VectorXf b;
  Dense(const PolicyTensors& file, const std::string& prefix);
  MatrixXf operator()(const MatrixXf& x) const { return (W * x).colwise() + b; }
};

/// Over each column; biased variance.
struct LayerNorm {
  VectorXf scale, offset;
  float epsilon;
  MatrixXf operator()(const MatrixXf& x) const;
};

/// Hidden layers act(norm(W x + b)), the norm optional, then a linear one.
struct Mlp {
  std::vector<Dense> layers;
  std::vector<LayerNorm> norms;  ///< one a hidden layer, or none
  Activation f;
  Mlp(const PolicyTensors& file, const std::string& prefix, const nlohmann::json& config);
  MatrixXf operator()(MatrixXf x) const;
};

struct Attention {
  Dense query, key, value, output;
  int heads;
  Attention(const PolicyTensors& file, const std::string& prefix, int heads);
  MatrixXf operator()(const MatrixXf& q_in, const MatrixXf& k_in, const MatrixXf& v_in) const;
};

/// (height * width, channels): one column a channel, row by row.
struct Image {
  int height = 0, width = 0;
  MatrixXf pixels;
};

/// Padding kernel / 2. Every output pixel's neighbourhood is copied to a row, then one product.
struct Convolution {
  MatrixXf W;  ///< (out, in * kernel * kernel)
  VectorXf b;
  int kernel, stride;
  /// Folds the frozen batch norm `norm` into the weights.
  Convolution(const PolicyTensors& file, const std::string& weight, const std::string& norm,
              int stride);
  Image operator()(const Image& x) const;
};

/// torchvision's ResNet-18 up to layer4.
struct Resnet18 {
  struct Block {
    Convolution first, second;
    std::vector<Convolution> shortcut;  ///< one where the shape changes, else none
  };
  Convolution stem;
  std::vector<Block> blocks;
  Resnet18(const PolicyTensors& file, const std::string& prefix);
  Image operator()(const Image& x) const;
};

}  // namespace tandem::bench
