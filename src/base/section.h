#pragma once

#include <yaml-cpp/yaml.h>

#include <cstdint>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

namespace tandem {

/// What is wrong with a scenario file: file, line, dotted key, value, limit.
class ScenarioError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// One mapping of a scenario file, read strictly: a key that nobody asks for is an error, as is a
/// missing one.
///
/// Values have no defaults here; the files in config/ are the one place that holds them, each with
/// its comment. Every function throws ScenarioError with a sentence such as
///   `scenario.yaml:14: task.policy_rate_hz is 0; it must be in [1, 200].`
class Section {
 public:
  /// Root of a scenario file.
  static Section load(const std::string& path);

  /// The same of a text; `name` stands for the file in sentences.
  static Section parse(const std::string& text, const std::string& name);

  /// Whether the key is there: for keys that exclude each other.
  bool has(const std::string& key) const;
  /// Entries of a list; 0 when the key is missing or no list.
  size_t size(const std::string& key) const;

  Section section(const std::string& key);
  double number(const std::string& key, double low, double high);
  int64_t integer(const std::string& key, int64_t low, int64_t high);
  bool boolean(const std::string& key);
  std::string text(const std::string& key);
  std::string choice(const std::string& key, const std::vector<std::string>& allowed);
  std::vector<double> numbers(const std::string& key, size_t count, double low, double high);
  std::vector<std::string> texts(const std::string& key);

  /// Leaves a key to another program.
  void leave(const std::string& key);

  /// Call when everything was asked for: refuses what is left, with the nearest known name.
  void finish() const;

  /// "FILE:LINE: dotted.key", the start of every sentence about that key.
  std::string place(const std::string& key) const;

 private:
  Section(YAML::Node node, std::string file, std::string prefix);
  YAML::Node find(const std::string& key);

  YAML::Node node_;
  std::string file_;
  std::string prefix_;
  std::vector<std::string> known_;
};

/// The name in `known` with the smallest edit distance to `name`; empty when there is none.
std::string nearest_name(const std::string& name, const std::vector<std::string>& known);

}  // namespace tandem
