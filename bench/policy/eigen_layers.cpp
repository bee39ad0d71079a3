#include "policy/eigen_layers.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace tandem::bench {
namespace {

constexpr float kMlpEpsilon = 1e-6f, kBatchNormEpsilon = 1e-5f;

Image relu(Image x) {
  x.pixels = x.pixels.cwiseMax(0.0f);
  return x;
}

/// 3 x 3, stride 2, padding 1.
Image max_pool(const Image& x) {
  Image y{(x.height + 1) / 2, (x.width + 1) / 2, {}};
  y.pixels.resize(y.height * y.width, x.pixels.cols());
  for (int row = 0; row < y.height; ++row) {
    for (int column = 0; column < y.width; ++column) {
      const int top = std::max(2 * row - 1, 0), bottom = std::min(2 * row + 1, x.height - 1);
      const int left = std::max(2 * column - 1, 0), right = std::min(2 * column + 1, x.width - 1);
      auto most = y.pixels.row(row * y.width + column);
      most = x.pixels.row(top * x.width + left);
      for (int i = top; i <= bottom; ++i) {
        for (int j = left; j <= right; ++j) most = most.cwiseMax(x.pixels.row(i * x.width + j));
      }
    }
  }
  return y;
}

}  // namespace

Activation activation(const std::string& name) {
  if (name == "relu") return Activation::relu;
  if (name == "tanh") return Activation::tanh;
  if (name == "gelu") return Activation::gelu;
  throw std::runtime_error("activation " + name + " is unknown.");
}

MatrixXf activate(Activation f, const MatrixXf& x) {
  switch (f) {
    case Activation::relu:
      return x.cwiseMax(0.0f);
    case Activation::tanh:
      return x.array().tanh();
    case Activation::gelu:
      return 0.5f * x.array() *
             (1.0f + (0.7978845608f * (x.array() + 0.044715f * x.array().cube())).tanh());
    case Activation::identity:
      break;
  }
  return x;
}

MatrixXf matrix(const PolicyTensors& file, const std::string& name) {
  using RowMajor = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const Tensor& tensor = file.at(name);
  return Eigen::Map<const RowMajor>(tensor.values.data(), tensor.shape.at(0), tensor.shape.at(1));
}

VectorXf vector(const PolicyTensors& file, const std::string& name) {
  const Tensor& tensor = file.at(name);
  return Eigen::Map<const VectorXf>(tensor.values.data(),
                                    static_cast<Eigen::Index>(tensor.values.size()));
}

Dense::Dense(const PolicyTensors& file, const std::string& prefix)
    : W(matrix(file, prefix + ".weight")), b(vector(file, prefix + ".bias")) {}

MatrixXf LayerNorm::operator()(const MatrixXf& x) const {
  const MatrixXf centred = x.rowwise() - x.colwise().mean();
  const Eigen::RowVectorXf deviation =
      (centred.array().square().colwise().mean() + epsilon).sqrt().matrix();
  return ((centred.array().rowwise() / deviation.array()).colwise() * scale.array()).colwise() +
         offset.array();
}

Mlp::Mlp(const PolicyTensors& file, const std::string& prefix, const nlohmann::json& config)
    : f(activation(config.at("activation"))) {
  const std::size_t hidden = config.at("hidden").size();
  for (std::size_t i = 0; i <= hidden; ++i) {
    const std::string layer = prefix + ".layers." + std::to_string(i);
    layers.emplace_back(file, layer);
    if (i < hidden && config.at("layer_norm")) {
      norms.push_back(
          {vector(file, layer + ".norm_scale"), vector(file, layer + ".norm_offset"), kMlpEpsilon});
    }
  }
}

MatrixXf Mlp::operator()(MatrixXf x) const {
  for (std::size_t i = 0; i + 1 < layers.size(); ++i) {
    x = layers[i](x);
    if (!norms.empty()) x = norms[i](x);
    x = activate(f, x);
  }
  return layers.back()(x);
}

Attention::Attention(const PolicyTensors& file, const std::string& prefix, int heads)
    : query(file, prefix + ".query"),
      key(file, prefix + ".key"),
      value(file, prefix + ".value"),
      output(file, prefix + ".output"),
      heads(heads) {}

MatrixXf Attention::operator()(const MatrixXf& q_in, const MatrixXf& k_in,
                               const MatrixXf& v_in) const {
  const MatrixXf q = query(q_in), k = key(k_in), v = value(v_in);
  const Eigen::Index size = q.rows() / heads;
  MatrixXf y(q.rows(), q.cols());
  for (int head = 0; head < heads; ++head) {
    const auto rows = Eigen::seqN(head * size, size);
    MatrixXf weights = k(rows, Eigen::all).transpose() * q(rows, Eigen::all);  // (keys, queries)
    weights /= std::sqrt(static_cast<float>(size));
    weights = (weights.rowwise() - weights.colwise().maxCoeff()).array().exp();
    const Eigen::RowVectorXf sums = weights.colwise().sum();
    weights.array().rowwise() /= sums.array();
    y(rows, Eigen::all) = v(rows, Eigen::all) * weights;
  }
  return output(y);
}

Convolution::Convolution(const PolicyTensors& file, const std::string& weight,
                         const std::string& norm, int stride)
    : stride(stride) {
  const Tensor& tensor = file.at(weight);
  kernel = static_cast<int>(tensor.shape.at(2));
  using RowMajor = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  W = Eigen::Map<const RowMajor>(tensor.values.data(), tensor.shape[0],
                                 tensor.shape[1] * kernel * kernel);
  const VectorXf deviation =
      (vector(file, norm + ".running_var").array() + kBatchNormEpsilon).sqrt();
  const VectorXf scale = vector(file, norm + ".weight").cwiseQuotient(deviation);
  W = scale.asDiagonal() * W;
  b = vector(file, norm + ".bias") - scale.cwiseProduct(vector(file, norm + ".running_mean"));
}

Image Convolution::operator()(const Image& x) const {
  const int padding = kernel / 2;
  Image y{(x.height + 2 * padding - kernel) / stride + 1,
          (x.width + 2 * padding - kernel) / stride + 1,
          {}};
  MatrixXf neighbours = MatrixXf::Zero(y.height * y.width, W.cols());
  for (Eigen::Index j = 0; j < W.cols(); ++j) {
    const Eigen::Index channel = j / (kernel * kernel);
    const int down = static_cast<int>(j / kernel % kernel) - padding;
    const int right = static_cast<int>(j % kernel) - padding;
    for (int row = 0; row < y.height; ++row) {
      const int from_row = row * stride + down;
      if (from_row < 0 || from_row >= x.height) continue;
      for (int column = 0; column < y.width; ++column) {
        const int from = column * stride + right;
        if (from < 0 || from >= x.width) continue;
        neighbours(row * y.width + column, j) = x.pixels(from_row * x.width + from, channel);
      }
    }
  }
  y.pixels = (neighbours * W.transpose()).rowwise() + b.transpose();
  return y;
}

Resnet18::Resnet18(const PolicyTensors& file, const std::string& prefix)
    : stem(file, prefix + ".conv1.weight", prefix + ".bn1", 2) {
  for (int layer = 1; layer <= 4; ++layer) {
    for (int i = 0; i < 2; ++i) {
      const std::string block = prefix + ".layer" + std::to_string(layer) + "." + std::to_string(i);
      const int stride = layer > 1 && i == 0 ? 2 : 1;
      blocks.push_back({{file, block + ".conv1.weight", block + ".bn1", stride},
                        {file, block + ".conv2.weight", block + ".bn2", 1},
                        {}});
      if (stride == 2) {
        blocks.back().shortcut.emplace_back(file, block + ".downsample.0.weight",
                                            block + ".downsample.1", stride);
      }
    }
  }
}

Image Resnet18::operator()(const Image& input) const {
  Image x = max_pool(relu(stem(input)));
  for (const Block& block : blocks) {
    Image y = block.second(relu(block.first(x)));
    y.pixels += block.shortcut.empty() ? x.pixels : block.shortcut[0](x).pixels;
    x = relu(std::move(y));
  }
  return x;
}

}  // namespace tandem::bench
