#include "policy_runtime/policies/mlp.h"

#include <algorithm>
#include <cmath>

#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/file/strict_json.h"

namespace tandem::policy {
namespace {

constexpr int kMaxHorizon = 256;
constexpr int kMaxWidth = 8192;
constexpr std::size_t kMaxHiddenLayers = 16;

int integer(const SafetensorsFile& file, const char* what, const nlohmann::json& value, int high) {
  if (!value.is_number_unsigned() || value < 1 || value > high) {
    throw PolicyError(file.path() + ": config " + what + " is " + printable(value.dump()) +
                      "; it must be an integer in [1, " + std::to_string(high) +
                      "]. Correct the method's configuration.");
  }
  return value.get<int>();
}

[[noreturn]] void refuse(const SafetensorsFile& file, const std::string& sentence) {
  throw PolicyError(file.path() + ": config " + sentence + " Correct the method's configuration.");
}

Mlp::Config read_config(const SafetensorsFile& file) {
  const auto json = parse_strict_json(file.metadata("config"), file.path() + ": config");
  const std::vector<std::string> keys = {"hidden", "activation", "layer_norm", "horizon", "output"};
  if (!json.is_object()) refuse(file, "is not a JSON object.");
  for (const auto& [key, value] : json.items()) {
    if (std::find(keys.begin(), keys.end(), key) == keys.end()) {
      refuse(file, "has the unknown key " + printable(key) + ".");
    }
  }
  for (const std::string& key : keys) {
    if (!json.contains(key)) refuse(file, "lacks the key " + printable(key) + ".");
  }

  Mlp::Config config;
  if (!json["hidden"].is_array() || json["hidden"].size() > kMaxHiddenLayers) {
    refuse(file, "hidden must list at most " + std::to_string(kMaxHiddenLayers) + " widths.");
  }
  for (const auto& width : json["hidden"]) {
    config.hidden.push_back(integer(file, "hidden", width, kMaxWidth));
  }
  if (!json["activation"].is_string() || json["activation"] == "identity" ||
      !activation_from_name(json["activation"].get<std::string>(), config.activation)) {
    refuse(file, "activation is " + printable(json["activation"].dump()) +
                     "; it must be relu, tanh or gelu.");
  }
  if (!json["layer_norm"].is_boolean()) refuse(file, "layer_norm must be true or false.");
  config.layer_norm = json["layer_norm"].get<bool>();
  config.horizon = integer(file, "horizon", json["horizon"], kMaxHorizon);
  if (json["output"] != "tanh") {
    refuse(file, "output is " + printable(json["output"].dump()) + "; it must be tanh.");
  }
  return config;
}

// An empty network of the right shapes; its size is known before any tensor is read.
std::vector<Dense> plan_layers(const Mlp::Config& config, int observation_size, int chunk_size) {
  std::vector<Dense> layers;
  int in = observation_size;
  for (const int width : config.hidden) {
    layers.emplace_back(in, width, config.layer_norm, config.activation);
    in = width;
  }
  layers.emplace_back(in, chunk_size, false, Activation::kTanh);
  return layers;
}

}  // namespace

std::unique_ptr<Policy> load_mlp(SafetensorsFile& file, Header header) {
  Mlp::Config config = read_config(file);
  header.horizon = config.horizon;

  // every shape is compared with the file before the arena is sized by the config
  std::vector<Dense> layers = plan_layers(config, header.observation_size(), header.chunk_size());
  std::size_t size = 0;
  for (std::size_t i = 0; i < layers.size(); ++i) {
    file.check_shape("actor.layers." + std::to_string(i) + ".weight",
                     {layers[i].out, layers[i].in});
    size += layers[i].size();
  }

  const std::int64_t O = header.observation_size();
  Mlp::Weights weights = {file.take("normalizer.mean", {O}), file.take("normalizer.scale", {O}),
                          std::move(layers), AlignedBuffer(size)};
  float* arena = weights.arena.data();
  for (std::size_t i = 0; i < weights.layers.size(); ++i) {
    arena = weights.layers[i].load(file, "actor.layers." + std::to_string(i), arena);
  }
  return std::make_unique<Mlp>(std::move(header), std::move(config), std::move(weights));
}

Mlp::Mlp(Header header, Config config, Weights weights)
    : Policy(std::move(header)), config_(std::move(config)), weights_(std::move(weights)) {
  input_size_ = padded(weights_.layers.front().in);
  layer_size_ = 0;
  for (const Dense& layer : weights_.layers) layer_size_ = std::max(layer_size_, padded(layer.out));
}

// input | one layer's output | the next one's
std::size_t Mlp::workspace_size() const noexcept { return input_size_ + 2 * layer_size_; }

bool Mlp::forward(const float* observation, float* chunk, Workspace& workspace) const noexcept {
  const Kernels& k = kernels();
  float* x = workspace.data();
  float* y = x + input_size_;
  float* other = y + layer_size_;
  const int O = header().observation_size();
  const int chunk_size = header().chunk_size();

  // the input's padding stays zero: nothing else ever writes there
  bool finite = true;
  for (int i = 0; i < O; ++i) {
    x[i] = (observation[i] - weights_.mean[i]) * weights_.scale[i];
    finite = finite && std::isfinite(x[i]);
  }
  if (!finite) {
    std::fill(chunk, chunk + chunk_size, 0.0f);
    return false;
  }

  const float* in = x;
  for (const Dense& layer : weights_.layers) {
    layer.forward(k, in, y);
    in = y;
    std::swap(y, other);
  }

  std::copy(in, in + chunk_size, chunk);
  for (int i = 0; i < chunk_size; ++i) finite = finite && std::isfinite(chunk[i]);
  if (!finite) std::fill(chunk, chunk + chunk_size, 0.0f);
  return finite;
}

}  // namespace tandem::policy
