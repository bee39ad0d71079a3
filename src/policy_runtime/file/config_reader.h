#pragma once

#include <initializer_list>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "policy_runtime/kernels/kernels.h"

namespace tandem::policy {

/// Reads one JSON object of a file's config key by key, and refuses what is missing, of the wrong
/// kind, out of range or never asked for. Every function throws PolicyError with a sentence that
/// names file, key, value and range.
class ConfigReader {
 public:
  /// @param where opens every message, e.g. "policy.safetensors: config".
  ConfigReader(nlohmann::json object, std::string where);

  int integer(const std::string& key, int low, int high);
  double number(const std::string& key, double low, double high);
  bool boolean(const std::string& key);
  /// A text of 1 to 64 printable characters.
  std::string name(const std::string& key);
  /// Index of the text in `choices`.
  std::size_t choice(const std::string& key, std::initializer_list<std::string_view> choices);
  /// relu, tanh or gelu.
  Activation activation(const std::string& key);
  /// At most `most` integers.
  std::vector<int> integers(const std::string& key, int low, int high, std::size_t most);

  /// Whether the value is null; other kinds are left for another call.
  bool is_null(const std::string& key);
  ConfigReader object(const std::string& key);
  /// `least` to `most` objects.
  std::vector<ConfigReader> objects(const std::string& key, std::size_t least, std::size_t most);

  /// To be called at the end: refuses the first key that nobody asked for.
  void finish() const;

  /// Refuses the object as a whole: `sentence` says what is wrong and what is allowed.
  [[noreturn]] void refuse(const std::string& sentence) const;

 private:
  const nlohmann::json& at(const std::string& key);
  [[noreturn]] void refuse(const std::string& key, const nlohmann::json& value,
                           const std::string& allowed) const;

  nlohmann::json object_;
  std::string where_;
  std::set<std::string> asked_;
};

}  // namespace tandem::policy
