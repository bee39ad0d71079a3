#include "policy_runtime/file/strict_json.h"

#include <set>
#include <vector>

#include "policy_runtime/policy_error.h"

namespace tandem::policy {
namespace {

constexpr int kMaxDepth = 16;

}  // namespace

nlohmann::json parse_strict_json(std::string_view text, const std::string& where) {
  using Json = nlohmann::json;
  std::vector<std::set<std::string>> keys;  // one set per open object

  const auto check = [&](int depth, Json::parse_event_t event, Json& value) {
    switch (event) {
      case Json::parse_event_t::object_start:
        keys.emplace_back();
        [[fallthrough]];
      case Json::parse_event_t::array_start:
        if (depth >= kMaxDepth) {
          throw PolicyError(where + " nests deeper than " + std::to_string(kMaxDepth) +
                            " levels. Write the file again.");
        }
        break;
      case Json::parse_event_t::object_end:
        keys.pop_back();
        break;
      case Json::parse_event_t::key:
        if (!keys.back().insert(value.get<std::string>()).second) {
          throw PolicyError(where + " names the key " + printable(value.get<std::string>()) +
                            " twice; each may appear once. Write the file again.");
        }
        break;
      default:
        break;
    }
    return true;
  };

  // to the parser a zero byte is the end, whatever follows it
  if (text.find('\0') != text.npos) {
    throw PolicyError(where + " is not valid JSON (it holds a zero byte). Write the file again.");
  }
  try {
    return Json::parse(text.begin(), text.end(), check);
  } catch (const Json::exception& error) {
    throw PolicyError(where + " is not valid JSON (" + printable(error.what(), 160) +
                      "). Write the file again.");
  }
}

}  // namespace tandem::policy
