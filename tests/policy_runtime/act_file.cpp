#include "policy_runtime/act_file.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace tandem::policy::testing {
namespace {

using Json = nlohmann::json;

Json config_of(const TransformerSpec& spec, const std::vector<int>& tokens) {
  Json config = {{"model_size", spec.model_size},
                 {"heads", spec.heads},
                 {"feedforward", spec.feedforward},
                 {"encoder_layers", spec.encoder_layers},
                 {"decoder_layers", spec.decoder_layers},
                 {"activation", spec.activation},
                 {"tokens", Json::array()}};
  for (const int size : tokens) {
    config["tokens"].push_back(
        {{"name", "token_" + std::to_string(config["tokens"].size())}, {"size", size}});
  }
  return config;
}

Tensor random_positions(int n, int d, std::mt19937& random) {
  return random_tensor({n, d}, 0.0f, 1.0f, random);
}

Image black(const Camera& camera) { return Image(camera.height * camera.width * 3); }

// What ACT and the flow field have in common.
void add_transformer(PolicyFile& file, const std::string& prefix, const TransformerSpec& spec,
                     const std::vector<int>& tokens, int horizon, std::mt19937& random) {
  const int d = spec.model_size;
  for (std::size_t i = 0; i < tokens.size(); ++i) {
    add_linear(file, prefix + ".tokens." + std::to_string(i), tokens[i], d, random);
  }
  for (int l = 0; l < spec.encoder_layers; ++l) {
    add_encoder_layer(file, prefix + ".encoder." + std::to_string(l), spec, random);
  }
  for (int l = 0; l < spec.decoder_layers; ++l) {
    add_decoder_layer(file, prefix + ".decoder." + std::to_string(l), spec, random);
  }
  add_norm(file, prefix + ".norm", d, random);
  file.tensors[prefix + ".query_position"] = random_positions(horizon, d, random);
}

void append_tokens(Matrix& memory, const PolicyFile& file, const std::string& prefix,
                   const std::vector<int>& tokens, const std::vector<double>& x) {
  auto next = x.begin();
  for (std::size_t i = 0; i < tokens.size(); ++i, next += tokens[i - 1]) {
    const Matrix slice = {{next, next + tokens[i]}};
    memory.push_back(linear(file, prefix + ".tokens." + std::to_string(i), slice)[0]);
  }
}

Matrix encode(const PolicyFile& file, const std::string& prefix, const TransformerSpec& spec,
              Matrix X, const Matrix& positions) {
  for (int l = 0; l < spec.encoder_layers; ++l) {
    X = encoder_layer(file, prefix + ".encoder." + std::to_string(l), spec, X, positions);
  }
  return X;
}

Matrix decode(const PolicyFile& file, const std::string& prefix, const TransformerSpec& spec,
              Matrix X, const Matrix& memory, const Matrix& positions) {
  const Matrix query_positions = matrix(file, prefix + ".query_position");
  for (int l = 0; l < spec.decoder_layers; ++l) {
    X = decoder_layer(file, prefix + ".decoder." + std::to_string(l), spec, X, query_positions,
                      memory, positions);
  }
  return norm(file, prefix + ".norm", X);
}

}  // namespace

Json ActFormula::config() const {
  Json config = config_of(spec.transformer, spec.tokens);
  config.update({{"horizon", sizes.horizon},
                 {"latent_size", spec.latent_size},
                 {"sample_latent", spec.sample_latent},
                 {"cameras", Json::array()},
                 {"backbone", nullptr},
                 {"output", spec.output}});
  for (const Camera& camera : spec.cameras) {
    config["cameras"].push_back(
        {{"name", camera.name}, {"height", camera.height}, {"width", camera.width}});
    config["backbone"] = Json::parse(cnn_config(spec.backbone));
  }
  return config;
}

void ActFormula::add(PolicyFile& file, const std::string& prefix, std::mt19937& random) const {
  const int d = spec.transformer.model_size, A = static_cast<int>(sizes.axes.size());
  add_transformer(file, prefix, spec.transformer, spec.tokens, sizes.horizon, random);
  add_linear(file, prefix + ".latent", spec.latent_size, d, random);
  file.tensors[prefix + ".token_position"] =
      random_positions(1 + static_cast<int>(spec.tokens.size()), d, random);
  add_linear(file, prefix + ".action", d, A, random);
  if (spec.output == "linear") {
    file.tensors[prefix + ".output.scale"] = random_tensor({A}, 0.0f, 1.0f, random);
    file.tensors[prefix + ".output.offset"] = random_tensor({A}, 0.0f, 1.0f, random);
  }
  if (spec.cameras.empty()) return;
  const PolicyFile cnn = make_cnn(spec.backbone, random());
  for (const auto& [name, tensor] : cnn.tensors) {
    file.tensors[prefix + name.substr(name.find('.'))] = tensor;
  }
  add_linear(file, prefix + ".camera_projection", spec.backbone.back().channels, d, random);
  for (const Camera& camera : spec.cameras) {
    const Volume features =
        evaluate_cnn(cnn, spec.backbone, black(camera), camera.height, camera.width);
    file.tensors[prefix + ".camera_position." + camera.name] =
        random_positions(features.height * features.width, d, random);
    const std::int64_t N = 8;
    file.tensors["golden.image." + camera.name] = {
        {N, camera.height, camera.width, 3},
        std::vector<float>(N * camera.height * camera.width * 3),
        "U8"};
  }
}

std::vector<double> ActFormula::evaluate(const PolicyFile& file, const std::string& prefix,
                                         const std::vector<double>& x, const float* noise) const {
  std::vector<Image> images;
  for (const Camera& camera : spec.cameras) images.push_back(black(camera));
  return evaluate(file, prefix, x, noise, images);
}

std::vector<double> ActFormula::evaluate(const PolicyFile& file, const std::string& prefix,
                                         const std::vector<double>& x, const float* noise,
                                         const std::vector<Image>& images) const {
  std::vector<double> z(spec.latent_size);
  if (spec.sample_latent) z.assign(noise, noise + spec.latent_size);
  Matrix memory = linear(file, prefix + ".latent", {z});
  append_tokens(memory, file, prefix, spec.tokens, x);
  Matrix positions = matrix(file, prefix + ".token_position");
  for (std::size_t i = 0; i < images.size(); ++i) {
    const Camera& camera = spec.cameras[i];
    const Volume features =
        evaluate_cnn(file, spec.backbone, images[i], camera.height, camera.width);
    for (auto pixel = features.values.begin(); pixel != features.values.end();
         pixel += features.channels) {
      const Matrix token = {{pixel, pixel + features.channels}};
      memory.push_back(linear(file, prefix + ".camera_projection", token)[0]);
    }
    const Matrix more = matrix(file, prefix + ".camera_position." + camera.name);
    positions.insert(positions.end(), more.begin(), more.end());
  }

  memory = encode(file, prefix, spec.transformer, memory, positions);
  const Matrix zeros(sizes.horizon, std::vector<double>(spec.transformer.model_size));
  const Matrix actions = linear(file, prefix + ".action",
                                decode(file, prefix, spec.transformer, zeros, memory, positions));
  std::vector<double> chunk;
  for (const auto& action : actions) {
    for (std::size_t a = 0; a < action.size(); ++a) {
      chunk.push_back(spec.output == "tanh"
                          ? std::tanh(action[a])
                          : action[a] * file.tensors.at(prefix + ".output.scale").values[a] +
                                file.tensors.at(prefix + ".output.offset").values[a]);
    }
  }
  return chunk;
}

Json FlowTransformerFormula::config() const {
  Json config = config_of(spec.transformer, spec.tokens);
  config.update({{"field", "transformer"},
                 {"horizon", sizes.horizon},
                 {"steps", spec.steps},
                 {"time_features", spec.time_features},
                 {"output", "clip"}});
  return config;
}

void FlowTransformerFormula::add(PolicyFile& file, const std::string& prefix,
                                 std::mt19937& random) const {
  const int d = spec.transformer.model_size, A = static_cast<int>(sizes.axes.size());
  add_transformer(file, prefix, spec.transformer, spec.tokens, sizes.horizon, random);
  file.tensors[prefix + ".token_position"] =
      random_positions(static_cast<int>(spec.tokens.size()), d, random);
  add_linear(file, prefix + ".action", A, d, random);
  add_linear(file, prefix + ".time", spec.time_features, d, random);
  file.tensors.erase(prefix + ".time.bias");
  add_linear(file, prefix + ".output", d, A, random);
}

std::vector<double> FlowTransformerFormula::evaluate(const PolicyFile& file,
                                                     const std::string& prefix,
                                                     const std::vector<double>& x,
                                                     const float* noise) const {
  const Matrix positions = matrix(file, prefix + ".token_position");
  Matrix memory;
  append_tokens(memory, file, prefix, spec.tokens, x);
  memory = encode(file, prefix, spec.transformer, memory, positions);

  const int A = static_cast<int>(sizes.axes.size()), half = spec.time_features / 2;
  Matrix a;
  for (int j = 0; j < sizes.horizon; ++j) a.emplace_back(noise + j * A, noise + (j + 1) * A);
  for (int k = 0; k < spec.steps; ++k) {
    std::vector<double> phi(2 * half);
    for (int i = 1; i <= half; ++i) {
      phi[i - 1] = std::cos(std::numbers::pi * i * k / spec.steps);
      phi[half + i - 1] = std::sin(std::numbers::pi * i * k / spec.steps);
    }
    const Matrix time(sizes.horizon, linear(file, prefix + ".time", {phi})[0]);
    Matrix y = sum(linear(file, prefix + ".action", a), matrix(file, prefix + ".query_position"));
    y = decode(file, prefix, spec.transformer, sum(y, time), memory, positions);
    Matrix v = linear(file, prefix + ".output", y);
    for (auto& row : v) {
      for (double& value : row) value /= spec.steps;
    }
    a = sum(a, v);
  }
  std::vector<double> chunk;
  for (const auto& row : a) {
    for (const double value : row) chunk.push_back(std::clamp(value, -1.0, 1.0));
  }
  return chunk;
}

void expect_same_samples(const Head& head, int observation_size) {
  constexpr int kSamples = 3;
  constexpr float kBehind = 123.0f;
  std::mt19937 random(1);
  const auto noise = random_numbers(kSamples * head.noise_size(), 1.0f, random);
  const auto observation = random_numbers(observation_size, 1.0f, random);
  const std::size_t stride = padded(head.chunk_size()), size = head.workspace_size(kSamples);
  AlignedBuffer x(observation_size), together(kSamples * stride), alone(stride),
      workspace(size + kPadding);
  std::copy(observation.begin(), observation.end(), x.data());
  std::fill_n(workspace.data(), size, std::nanf(""));
  std::fill_n(workspace.data() + size, kPadding, kBehind);

  head.forward({.x = x.data(), .noise = noise.data()}, kSamples, together.data(), workspace.data());
  for (int sample = 0; sample < kSamples; ++sample) {
    std::fill_n(workspace.data(), size, std::nanf(""));
    head.forward({.x = x.data(), .noise = noise.data() + sample * head.noise_size()}, 1,
                 alone.data(), workspace.data());
    for (int i = 0; i < head.chunk_size(); ++i) {
      ASSERT_EQ(together.data()[sample * stride + i], alone.data()[i]) << sample << " " << i;
    }
  }
  for (int i = 0; i < kPadding; ++i) ASSERT_EQ(workspace.data()[size + i], kBehind);
}

}  // namespace tandem::policy::testing
