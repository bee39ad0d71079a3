#include "policy_runtime/file/config_reader.h"

#include <algorithm>
#include <utility>

#include "policy_runtime/policy_error.h"

namespace tandem::policy {
namespace {

std::string range(const std::string& low, const std::string& high) {
  return "in [" + low + ", " + high + "]";
}

bool is_plain_text(const nlohmann::json& value) {
  if (!value.is_string()) return false;
  const auto& text = value.get_ref<const std::string&>();
  return !text.empty() && text.size() <= 64 &&
         std::all_of(text.begin(), text.end(), [](char c) { return c > ' ' && c <= '~'; });
}

}  // namespace

ConfigReader::ConfigReader(nlohmann::json object, std::string where)
    : object_(std::move(object)), where_(std::move(where)) {
  if (!object_.is_object()) refuse("is not a JSON object.");
}

int ConfigReader::integer(const std::string& key, int low, int high) {
  const nlohmann::json& value = at(key);
  if (!value.is_number_integer() || value < low || value > high) {
    refuse(key, value, "an integer " + range(std::to_string(low), std::to_string(high)));
  }
  return value.get<int>();
}

double ConfigReader::number(const std::string& key, double low, double high) {
  const nlohmann::json& value = at(key);
  if (!value.is_number() || !(value.get<double>() >= low && value.get<double>() <= high)) {
    refuse(key, value, "a number " + range(std::to_string(low), std::to_string(high)));
  }
  return value.get<double>();
}

bool ConfigReader::boolean(const std::string& key) {
  const nlohmann::json& value = at(key);
  if (!value.is_boolean()) refuse(key, value, "true or false");
  return value.get<bool>();
}

std::string ConfigReader::name(const std::string& key) {
  const nlohmann::json& value = at(key);
  if (!is_plain_text(value)) refuse(key, value, "a name of 1 to 64 printable characters");
  return value.get<std::string>();
}

std::size_t ConfigReader::choice(const std::string& key,
                                 std::initializer_list<std::string_view> choices) {
  const nlohmann::json& value = at(key);
  std::string allowed;
  for (const std::string_view each : choices) {
    allowed += (allowed.empty() ? "" : " or ") + std::string(each);
  }
  if (!value.is_string()) refuse(key, value, allowed);
  const auto found = std::find(choices.begin(), choices.end(), value.get_ref<const std::string&>());
  if (found == choices.end()) refuse(key, value, allowed);
  return static_cast<std::size_t>(found - choices.begin());
}

Activation ConfigReader::activation(const std::string& key) {
  constexpr Activation kOf[] = {Activation::kRelu, Activation::kTanh, Activation::kGelu};
  return kOf[choice(key, {"relu", "tanh", "gelu"})];
}

std::vector<int> ConfigReader::integers(const std::string& key, int low, int high,
                                        std::size_t most) {
  const nlohmann::json& value = at(key);
  const auto fits = [&](const nlohmann::json& each) {
    return each.is_number_integer() && each >= low && each <= high;
  };
  if (!value.is_array() || value.size() > most || !std::all_of(value.begin(), value.end(), fits)) {
    refuse(key, value,
           "a list of at most " + std::to_string(most) + " integers " +
               range(std::to_string(low), std::to_string(high)));
  }
  return value.get<std::vector<int>>();
}

bool ConfigReader::is_null(const std::string& key) { return at(key).is_null(); }

ConfigReader ConfigReader::object(const std::string& key) {
  return ConfigReader(at(key), where_ + "." + key);
}

std::vector<ConfigReader> ConfigReader::objects(const std::string& key, std::size_t least,
                                                std::size_t most) {
  const nlohmann::json& value = at(key);
  if (!value.is_array() || value.size() < least || value.size() > most) {
    refuse(key, value,
           "a list of " + std::to_string(least) + " to " + std::to_string(most) + " objects");
  }
  std::vector<ConfigReader> readers;
  for (std::size_t i = 0; i < value.size(); ++i) {
    readers.emplace_back(value[i], where_ + "." + key + "[" + std::to_string(i) + "]");
  }
  return readers;
}

void ConfigReader::finish() const {
  for (const auto& [key, value] : object_.items()) {
    if (!asked_.contains(key)) refuse("has the unknown key " + printable(key) + ".");
  }
}

const nlohmann::json& ConfigReader::at(const std::string& key) {
  asked_.insert(key);
  const auto found = object_.find(key);
  if (found == object_.end()) refuse("lacks the key " + printable(key) + ".");
  return *found;
}

void ConfigReader::refuse(const std::string& key, const nlohmann::json& value,
                          const std::string& allowed) const {
  const std::string found = value.is_string() ? value.get<std::string>() : value.dump();
  refuse(key + " is " + printable(found) + "; it must be " + allowed + ".");
}

void ConfigReader::refuse(const std::string& sentence) const {
  throw PolicyError(where_ + " " + sentence + " Correct the method's configuration.");
}

}  // namespace tandem::policy
