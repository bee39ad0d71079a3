#include "policy_runtime/header.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <set>
#include <string_view>

#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/file/strict_json.h"
#include "policy_runtime/policy_error.h"

namespace tandem::policy {
namespace {

constexpr std::array<std::string_view, 14> kKeys = {"format",
                                                    "architecture",
                                                    "config",
                                                    "observation",
                                                    "action",
                                                    "task",
                                                    "method",
                                                    "execution",
                                                    "discount",
                                                    "version",
                                                    "env_steps",
                                                    "updates",
                                                    "episodes_trained_through",
                                                    "git_revision"};
constexpr std::size_t kMaxObservations = 4096;

template <typename Number>
Number number(const SafetensorsFile& file, const std::string& key, Number low, Number high) {
  const std::string& text = file.metadata(key);
  Number value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() ||
      !(value >= low && value <= high)) {
    throw PolicyError(file.path() + ": metadata \"" + key + "\" is " + printable(text) +
                      "; it must be a number in [" + std::to_string(low) + ", " +
                      std::to_string(high) + "]. Write the file with the current learner.");
  }
  return value;
}

std::vector<std::string> names(const SafetensorsFile& file, const std::string& key) {
  const std::string where = file.path() + ": metadata \"" + key + "\"";
  const nlohmann::json json = parse_strict_json(file.metadata(key), where);
  std::vector<std::string> result;
  std::set<std::string> seen;
  bool valid = json.is_array() && !json.empty() && json.size() <= kMaxObservations;
  for (std::size_t i = 0; valid && i < json.size(); ++i) {
    valid = json[i].is_string() && seen.insert(json[i].get<std::string>()).second;
    if (valid) result.push_back(json[i].get<std::string>());
  }
  if (!valid) {
    throw PolicyError(where + " is " + printable(file.metadata(key)) + "; it must list 1 to " +
                      std::to_string(kMaxObservations) +
                      " different names. Write the file with the current learner.");
  }
  return result;
}

void check_keys(const SafetensorsFile& file) {
  for (const auto& [key, value] : file.metadata()) {
    if (std::find(kKeys.begin(), kKeys.end(), key) == kKeys.end()) {
      throw PolicyError(file.path() + ": metadata " + printable(key) +
                        " is unknown. Write the file with a learner of this version.");
    }
  }
  if (file.metadata("format") != "tandem-policy-1") {
    throw PolicyError(
        file.path() + ": format is " + printable(file.metadata("format")) +
        "; this runtime reads tandem-policy-1. Write it with a learner of this version.");
  }
}

}  // namespace

Header read_header(const SafetensorsFile& file) {
  check_keys(file);
  constexpr std::int64_t kMost = std::int64_t{1} << 53;

  Header header;
  header.architecture = file.metadata("architecture");
  header.task = file.metadata("task");
  header.method = file.metadata("method");
  header.observation_names = names(file, "observation");
  header.action_axes = names(file, "action");
  header.execution = file.metadata("execution");
  if (!parse_strict_json(header.execution, file.path() + ": metadata \"execution\"").is_object()) {
    throw PolicyError(file.path() + ": metadata \"execution\" is " + printable(header.execution) +
                      "; it must be a JSON object. Write the file with the current learner.");
  }
  header.discount = number<double>(file, "discount", 1e-9, 1.0);
  header.version = number<std::int64_t>(file, "version", 0, kMost);
  header.env_steps = number<std::int64_t>(file, "env_steps", 0, kMost);
  header.updates = number<std::int64_t>(file, "updates", 0, kMost);
  header.episodes_trained_through =
      number<std::int64_t>(file, "episodes_trained_through", -1, kMost);
  header.git_revision = file.metadata("git_revision");
  return header;
}

}  // namespace tandem::policy
