#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

namespace tandem::policy {

/// JSON out of a file that nobody has vouched for: duplicate keys and nesting deeper than 16 are
/// refused (a reader that keeps the last duplicate and one that keeps the first would see different
/// policies).
/// @param where opens the message of the error, e.g. "policy.safetensors: config".
/// @throws PolicyError
nlohmann::json parse_strict_json(std::string_view text, const std::string& where);

}  // namespace tandem::policy
