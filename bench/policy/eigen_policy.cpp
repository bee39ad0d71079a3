/// Eigen's straightforward expressions as a contender of `./tandem bench policy`.
///
///   tandem_bench_eigen FILE     then orders on stdin, see contender.h
///
/// Built once per instruction set (Eigen chooses when it is compiled); the benchmark starts the
/// best that the machine runs. Knows the policies of the benchmark: mlp, act, flow with an MLP
/// field, and the best of several flow samples.

#include <cmath>
#include <cstdio>
#include <memory>
#include <stdexcept>

#include "policy/contender.h"
#include "policy/eigen_layers.h"

namespace tandem::bench {
namespace {

using Json = nlohmann::json;

VectorXf map(const std::vector<float>& values) {
  return Eigen::Map<const VectorXf>(values.data(), static_cast<Eigen::Index>(values.size()));
}

/// A flow's velocity field and its Euler steps.
struct Flow {
  Mlp field;
  int steps, features;

  Flow(const PolicyTensors& file, const std::string& prefix, const Json& config)
      : field(file, prefix, config),
        steps(config.at("steps")),
        features(config.at("time_features")) {}

  /// x (O), noise (h A, N) -> (h A, N) in [-1, 1]
  MatrixXf operator()(const VectorXf& x, MatrixXf a) const {
    MatrixXf input(x.size() + a.rows() + features, a.cols());
    for (int step = 0; step < steps; ++step) {
      const float t = static_cast<float>(step) / static_cast<float>(steps);
      const VectorXf angles =
          VectorXf::LinSpaced(features / 2, 1.0f, static_cast<float>(features / 2)) *
          (static_cast<float>(M_PI) * t);
      VectorXf phi(features);
      phi << angles.array().cos().matrix(), angles.array().sin().matrix();
      input << x.replicate(1, a.cols()), a, phi.replicate(1, a.cols());
      a += field(input) / static_cast<float>(steps);
    }
    return a.cwiseMax(-1.0f).cwiseMin(1.0f);
  }
};

/// Takes a normalised observation, noise and images, gives the chunk (h A).
struct Head {
  virtual ~Head() = default;
  virtual VectorXf operator()(const VectorXf& x, const Example& example) const = 0;
};

struct MlpHead : Head {
  Mlp mlp;
  explicit MlpHead(const PolicyTensors& file) : mlp(file, "actor", file.config()) {}
  VectorXf operator()(const VectorXf& x, const Example&) const override {
    return mlp(x).array().tanh();
  }
};

struct FlowHead : Head {
  Flow flow;
  explicit FlowHead(const PolicyTensors& file) : flow(file, "actor", file.config()) {}
  VectorXf operator()(const VectorXf& x, const Example& example) const override {
    return flow(x, map(example.noise));
  }
};

struct BestOfN : Head {
  Flow flow;
  std::vector<Mlp> critics;
  int samples;

  explicit BestOfN(const PolicyTensors& file)
      : flow(file, "actor.0", file.config().at("heads").at(0).at("config")),
        samples(file.config().at("heads").at(0).at("samples")) {
    const Json& critic = file.config().at("critic");
    for (int m = 0; m < critic.at("members").get<int>(); ++m) {
      critics.emplace_back(file, "critic." + std::to_string(m), critic);
    }
  }

  VectorXf operator()(const VectorXf& x, const Example& example) const override {
    const VectorXf noise = map(example.noise);
    const MatrixXf chunks = flow(x, noise.reshaped(noise.size() / samples, samples));
    MatrixXf input(x.size() + chunks.rows(), samples);
    input << x.replicate(1, samples), chunks;
    MatrixXf score = MatrixXf::Zero(1, samples);
    for (const Mlp& critic : critics) score += critic(input) / static_cast<float>(critics.size());
    Eigen::Index winner;
    score.row(0).maxCoeff(&winner);
    return chunks.col(winner);
  }
};

struct EncoderLayer {
  Attention attention;
  LayerNorm norm1, norm2;
  Dense feedforward1, feedforward2;
};

struct DecoderLayer {
  Attention self_attention, cross_attention;
  LayerNorm norm1, norm2, norm3;
  Dense feedforward1, feedforward2;
};

LayerNorm norm(const PolicyTensors& file, const std::string& prefix) {
  return {vector(file, prefix + ".scale"), vector(file, prefix + ".offset"), 1e-5f};
}

struct Act : Head {
  Json config;
  Activation f;
  Dense latent, action;
  LayerNorm last;
  MatrixXf token_position, query_position;
  std::vector<Dense> tokens;
  std::vector<EncoderLayer> encoder;
  std::vector<DecoderLayer> decoder;
  VectorXf image_mean, image_scale, output_scale, output_offset;
  std::vector<MatrixXf> camera_positions;
  std::unique_ptr<Resnet18> backbone;
  std::unique_ptr<Dense> projection;

  explicit Act(const PolicyTensors& file)
      : config(file.config()),
        f(activation(config.at("activation"))),
        latent(file, "actor.latent"),
        action(file, "actor.action"),
        last(norm(file, "actor.norm")),
        token_position(matrix(file, "actor.token_position").transpose()),
        query_position(matrix(file, "actor.query_position").transpose()) {
    const int heads = config.at("heads");
    for (std::size_t i = 0; i < config.at("tokens").size(); ++i) {
      tokens.emplace_back(file, "actor.tokens." + std::to_string(i));
    }
    for (int i = 0; i < config.at("encoder_layers").get<int>(); ++i) {
      const std::string layer = "actor.encoder." + std::to_string(i);
      encoder.push_back({{file, layer + ".attention", heads},
                         norm(file, layer + ".norm1"),
                         norm(file, layer + ".norm2"),
                         {file, layer + ".feedforward1"},
                         {file, layer + ".feedforward2"}});
    }
    for (int i = 0; i < config.at("decoder_layers").get<int>(); ++i) {
      const std::string layer = "actor.decoder." + std::to_string(i);
      decoder.push_back({{file, layer + ".self_attention", heads},
                         {file, layer + ".cross_attention", heads},
                         norm(file, layer + ".norm1"),
                         norm(file, layer + ".norm2"),
                         norm(file, layer + ".norm3"),
                         {file, layer + ".feedforward1"},
                         {file, layer + ".feedforward2"}});
    }
    if (config.at("output") == "linear") {
      output_scale = vector(file, "actor.output.scale");
      output_offset = vector(file, "actor.output.offset");
    }
    if (config.at("cameras").empty()) return;
    image_mean = vector(file, "actor.image.mean");
    image_scale = vector(file, "actor.image.scale");
    backbone = std::make_unique<Resnet18>(file, "actor.backbone");
    projection = std::make_unique<Dense>(file, "actor.camera_projection");
    for (const Json& camera : config.at("cameras")) {
      const std::string name = camera.at("name");
      camera_positions.push_back(matrix(file, "actor.camera_position." + name).transpose());
    }
  }

  /// The features (d, h' w') of camera i.
  MatrixXf see(std::size_t i, const std::vector<std::uint8_t>& pixels) const {
    const Json& camera = config.at("cameras")[i];
    Image image{camera.at("height"), camera.at("width"), {}};
    using Pixels = Eigen::Matrix<std::uint8_t, Eigen::Dynamic, 3, Eigen::RowMajor>;
    const Eigen::Map<const Pixels> raw(pixels.data(), image.height * image.width, 3);
    image.pixels = ((raw.cast<float>() / 255.0f).rowwise() - image_mean.transpose()) *
                   image_scale.asDiagonal();
    return (*projection)((*backbone)(image).pixels.transpose());
  }

  VectorXf operator()(const VectorXf& x, const Example& example) const override {
    const Eigen::Index state_tokens = 1 + static_cast<Eigen::Index>(tokens.size());
    Eigen::Index count = state_tokens, at = 0;
    for (const MatrixXf& position : camera_positions) count += position.cols();
    MatrixXf y(token_position.rows(), count), position(token_position.rows(), count);

    y.col(0) = latent.b;  // the latent is zero
    position.leftCols(state_tokens) = token_position;
    for (std::size_t i = 0; i < tokens.size(); ++i) {
      y.col(1 + static_cast<Eigen::Index>(i)) = tokens[i](x.segment(at, tokens[i].W.cols()));
      at += tokens[i].W.cols();
    }
    at = state_tokens;
    for (std::size_t i = 0; i < camera_positions.size(); ++i) {
      const Eigen::Index size = camera_positions[i].cols();
      y.middleCols(at, size) = see(i, example.images[i]);
      position.middleCols(at, size) = camera_positions[i];
      at += size;
    }

    for (const EncoderLayer& layer : encoder) {
      const MatrixXf placed = y + position;
      y = layer.norm1(y + layer.attention(placed, placed, y));
      y = layer.norm2(y + layer.feedforward2(activate(f, layer.feedforward1(y))));
    }

    const MatrixXf placed_memory = y + position;
    MatrixXf z = MatrixXf::Zero(query_position.rows(), query_position.cols());
    for (const DecoderLayer& layer : decoder) {
      MatrixXf placed = z + query_position;
      z = layer.norm1(z + layer.self_attention(placed, placed, z));
      placed = z + query_position;
      z = layer.norm2(z + layer.cross_attention(placed, placed_memory, y));
      z = layer.norm3(z + layer.feedforward2(activate(f, layer.feedforward1(z))));
    }

    MatrixXf chunk = action(last(z));  // (A, h): its columns in a row are the chunk
    if (output_scale.size() == 0) {
      chunk = chunk.array().tanh();
    } else {
      chunk = (output_scale.asDiagonal() * chunk).colwise() + output_offset;
    }
    return chunk.reshaped();
  }
};

std::unique_ptr<Head> make_head(const PolicyTensors& file) {
  const std::string& kind = file.architecture();
  if (kind == "mlp") return std::make_unique<MlpHead>(file);
  if (kind == "flow") return std::make_unique<FlowHead>(file);
  if (kind == "act") return std::make_unique<Act>(file);
  if (kind == "best_of_n") return std::make_unique<BestOfN>(file);
  throw std::runtime_error("architecture " + kind + " is none of the benchmark's.");
}

int contend(const std::string& path) {
  const PolicyTensors file(path);
  const VectorXf mean = vector(file, "normalizer.mean"), scale = vector(file, "normalizer.scale");
  const std::unique_ptr<Head> head = make_head(file);
  const std::vector<Example> examples = file.examples();
  const Tensor& golden = file.at("golden.chunk");
  const int chunk_size = static_cast<int>(golden.values.size() / examples.size());
  const std::string version = std::to_string(EIGEN_WORLD_VERSION) + "." +
                              std::to_string(EIGEN_MAJOR_VERSION) + "." +
                              std::to_string(EIGEN_MINOR_VERSION);
  const Json about = {{"version", version}, {"instructions", Eigen::SimdInstructionSetsInUse()}};
  return serve(about, static_cast<int>(examples.size()), chunk_size, [&](int i, float* chunk) {
    const VectorXf x = (map(examples[i].observation) - mean).cwiseProduct(scale);
    Eigen::Map<VectorXf>(chunk, chunk_size) = (*head)(x, examples[i]);
  });
}

}  // namespace
}  // namespace tandem::bench

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: tandem_bench_eigen FILE\n");
    return 2;
  }
  try {
    return tandem::bench::contend(argv[1]);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
