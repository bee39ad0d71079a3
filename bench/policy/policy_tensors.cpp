#include "policy/policy_tensors.h"

#include <cstring>
#include <fstream>
#include <iterator>
#include <stdexcept>

namespace tandem::bench {
namespace {

/// Row `i` of a tensor whose first axis counts the examples.
template <typename T>
std::vector<T> row(const std::vector<T>& all, std::int64_t rows, std::int64_t i) {
  const std::int64_t size = static_cast<std::int64_t>(all.size()) / rows;
  return {all.begin() + i * size, all.begin() + (i + 1) * size};
}

}  // namespace

PolicyTensors::PolicyTensors(const std::string& path) : path_(path) {
  std::ifstream in(path, std::ios::binary);
  const std::vector<char> bytes{std::istreambuf_iterator<char>(in), {}};
  std::uint64_t header_size = 0;
  if (bytes.size() > sizeof header_size) std::memcpy(&header_size, bytes.data(), 8);
  if (!in || header_size > bytes.size()) throw std::runtime_error(path + " is no policy file.");

  const auto header = nlohmann::json::parse(bytes.begin() + 8, bytes.begin() + 8 + header_size);
  const char* data = bytes.data() + 8 + header_size;
  for (const auto& [name, entry] : header.items()) {
    if (name == "__metadata__") continue;
    Tensor tensor;
    tensor.shape = entry.at("shape").get<std::vector<std::int64_t>>();
    const std::size_t begin = entry.at("data_offsets")[0], end = entry.at("data_offsets")[1];
    if (entry.at("dtype") == "U8") {
      tensor.bytes.assign(data + begin, data + end);
    } else if (entry.at("dtype") == "F32") {
      tensor.values.resize((end - begin) / sizeof(float));
      std::memcpy(tensor.values.data(), data + begin, end - begin);
    } else {
      throw std::runtime_error(path + ": " + name + " is neither F32 nor U8.");
    }
    tensors_.emplace(name, std::move(tensor));
  }
  const auto& metadata = header.at("__metadata__");
  architecture_ = metadata.at("architecture");
  config_ = nlohmann::json::parse(metadata.at("config").get<std::string>());
}

const Tensor& PolicyTensors::at(const std::string& name) const {
  const auto found = tensors_.find(name);
  if (found == tensors_.end()) throw std::runtime_error(path_ + " has no tensor " + name + ".");
  return found->second;
}

std::vector<Example> PolicyTensors::examples() const {
  const Tensor& observation = at("golden.observation");
  const std::int64_t n = observation.shape[0];
  std::vector<Example> examples(n);
  for (std::int64_t i = 0; i < n; ++i) {
    examples[i].observation = row(observation.values, n, i);
    if (has("golden.noise")) examples[i].noise = row(at("golden.noise").values, n, i);
    if (!config_.contains("cameras")) continue;
    for (const auto& camera : config_["cameras"]) {
      const std::string name = camera.at("name");
      examples[i].images.push_back(row(at("golden.image." + name).bytes, n, i));
    }
  }
  return examples;
}

}  // namespace tandem::bench
