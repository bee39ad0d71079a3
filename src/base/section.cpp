#include "base/section.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <sstream>

namespace tandem {
namespace {

std::string show(double value) {
  std::ostringstream out;
  out << value;
  return out.str();
}

size_t edit_distance(const std::string& a, const std::string& b) {
  std::vector<size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), 0);
  for (size_t i = 1; i <= a.size(); ++i) {
    size_t diagonal = row[0];
    row[0] = i;
    for (size_t j = 1; j <= b.size(); ++j) {
      const size_t substituted = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({row[j] + 1, row[j - 1] + 1, substituted});
    }
  }
  return row[b.size()];
}

}  // namespace

std::string nearest_name(const std::string& name, const std::vector<std::string>& known) {
  std::string best;
  size_t best_distance = SIZE_MAX;
  for (const std::string& candidate : known) {
    const size_t distance = edit_distance(name, candidate);
    if (distance < best_distance) {
      best_distance = distance;
      best = candidate;
    }
  }
  return best;
}

Section::Section(YAML::Node node, std::string file, std::string prefix)
    : node_(std::move(node)), file_(std::move(file)), prefix_(std::move(prefix)) {}

Section Section::load(const std::string& path) {
  YAML::Node root;
  try {
    root = YAML::LoadFile(path);
  } catch (const YAML::BadFile&) {
    throw ScenarioError(
        path + ": the scenario can't be read; check that the file exists and is readable.");
  } catch (const YAML::Exception& error) {
    throw ScenarioError(path + ":" + std::to_string(error.mark.line + 1) +
                        ": this is not valid YAML (" + error.msg + ").");
  }
  if (!root.IsMap()) throw ScenarioError(path + ":1: a scenario must be a mapping of sections.");
  return Section(root, path, "");
}

Section Section::parse(const std::string& text, const std::string& name) {
  try {
    const YAML::Node root = YAML::Load(text);
    if (root.IsMap()) return Section(root, name, "");
  } catch (const YAML::Exception& error) {
    throw ScenarioError(name + ":" + std::to_string(error.mark.line + 1) +
                        ": this is not valid YAML (" + error.msg + ").");
  }
  throw ScenarioError(name + ":1: a scenario must be a mapping of sections.");
}

std::string Section::place(const std::string& key) const {
  int line = node_.Mark().line;
  for (const auto& item : node_) {
    if (item.first.as<std::string>() == key) line = item.first.Mark().line;
  }
  return file_ + ":" + std::to_string(line + 1) + ": " + prefix_ + key;
}

bool Section::has(const std::string& key) const {
  const YAML::Node& view = node_;
  return view[key].IsDefined();
}

size_t Section::size(const std::string& key) const {
  const YAML::Node& view = node_;
  const YAML::Node value = view[key];
  return value.IsDefined() && value.IsSequence() ? value.size() : 0;
}

YAML::Node Section::find(const std::string& key) {
  known_.push_back(key);
  const YAML::Node& view = node_;
  const YAML::Node value = view[key];
  if (!value || value.IsNull())
    throw ScenarioError(place(key) + " is missing; the files in config/ show its default.");
  return value;
}

Section Section::section(const std::string& key) {
  const YAML::Node value = find(key);
  if (!value.IsMap()) throw ScenarioError(place(key) + " must be a mapping.");
  return Section(value, file_, prefix_ + key + ".");
}

double Section::number(const std::string& key, double low, double high) {
  const YAML::Node node = find(key);
  double value = 0;
  try {
    value = node.as<double>();
  } catch (const YAML::Exception&) {
    throw ScenarioError(place(key) + " is not a number; it must be in [" + show(low) + ", " +
                        show(high) + "].");
  }
  if (!(value >= low && value <= high)) {
    throw ScenarioError(place(key) + " is " + show(value) + "; it must be in [" + show(low) + ", " +
                        show(high) + "].");
  }
  return value;
}

int64_t Section::integer(const std::string& key, int64_t low, int64_t high) {
  const YAML::Node node = find(key);
  int64_t value = 0;
  try {
    value = node.as<int64_t>();
  } catch (const YAML::Exception&) {
    throw ScenarioError(place(key) + " is not a whole number; it must be in [" +
                        std::to_string(low) + ", " + std::to_string(high) + "].");
  }
  if (value < low || value > high) {
    throw ScenarioError(place(key) + " is " + std::to_string(value) + "; it must be in [" +
                        std::to_string(low) + ", " + std::to_string(high) + "].");
  }
  return value;
}

bool Section::boolean(const std::string& key) {
  const YAML::Node node = find(key);
  try {
    return node.as<bool>();
  } catch (const YAML::Exception&) {
    throw ScenarioError(place(key) + " must be true or false.");
  }
}

std::string Section::text(const std::string& key) {
  const YAML::Node node = find(key);
  if (!node.IsScalar()) throw ScenarioError(place(key) + " must be a text.");
  return node.as<std::string>();
}

std::string Section::choice(const std::string& key, const std::vector<std::string>& allowed) {
  const std::string value = text(key);
  if (std::find(allowed.begin(), allowed.end(), value) != allowed.end()) return value;
  std::string list;
  for (const std::string& name : allowed) list += (list.empty() ? "" : ", ") + name;
  throw ScenarioError(place(key) + " is '" + value + "'; it must be one of " + list +
                      ". Did you mean '" + nearest_name(value, allowed) + "'?");
}

std::vector<double> Section::numbers(const std::string& key, size_t count, double low,
                                     double high) {
  const YAML::Node node = find(key);
  const std::string need = " must be a list of " + std::to_string(count) + " numbers in [" +
                           show(low) + ", " + show(high) + "].";
  std::vector<double> values;
  try {
    values = node.as<std::vector<double>>();
  } catch (const YAML::Exception&) {
    throw ScenarioError(place(key) + need);
  }
  if (values.size() != count) {
    throw ScenarioError(place(key) + " has " + std::to_string(values.size()) + " entries; it" +
                        need);
  }
  for (const double value : values) {
    if (!(value >= low && value <= high))
      throw ScenarioError(place(key) + " holds " + show(value) + "; it" + need);
  }
  return values;
}

std::vector<std::string> Section::texts(const std::string& key) {
  const YAML::Node node = find(key);
  try {
    return node.as<std::vector<std::string>>();
  } catch (const YAML::Exception&) {
    throw ScenarioError(place(key) + " must be a list of names.");
  }
}

void Section::leave(const std::string& key) { known_.push_back(key); }

void Section::finish() const {
  for (const auto& item : node_) {
    const std::string key = item.first.as<std::string>();
    if (std::find(known_.begin(), known_.end(), key) == known_.end()) {
      throw ScenarioError(place(key) + " is not a known key. Did you mean '" + prefix_ +
                          nearest_name(key, known_) + "'?");
    }
  }
}

}  // namespace tandem
