#pragma once

#include <cstdint>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace tandem::bench {

/// One tensor of a policy file, row-major. Floats are in `values`, pixels (U8) in `bytes`.
struct Tensor {
  std::vector<std::int64_t> shape;
  std::vector<float> values;
  std::vector<std::uint8_t> bytes;
};

/// What one evaluation takes: an example of the file.
struct Example {
  std::vector<float> observation;                 ///< (O), raw
  std::vector<float> noise;                       ///< (noise_size)
  std::vector<std::vector<std::uint8_t>> images;  ///< one a camera of the config, (H, W, 3)
};

/// A policy file that the benchmark itself has written: names, shapes and order of the tensors are
/// taken for granted. (The runtime's own reader trusts nothing.)
class PolicyTensors {
 public:
  /// @throws std::runtime_error when the file can't be read or lacks what is asked for.
  explicit PolicyTensors(const std::string& path);

  const Tensor& at(const std::string& name) const;
  bool has(const std::string& name) const { return tensors_.count(name) != 0; }

  const std::string& architecture() const { return architecture_; }
  const nlohmann::json& config() const { return config_; }

  /// The golden examples' inputs.
  std::vector<Example> examples() const;

 private:
  std::string path_, architecture_;
  nlohmann::json config_;
  std::map<std::string, Tensor> tensors_;
};

}  // namespace tandem::bench
