#pragma once

#include <stdexcept>
#include <string>
#include <string_view>

namespace tandem::policy {

/// A policy file, or a kernel name, that we refuse. what() is one sentence or two for a person:
/// which file, what was found, the limit, the remedy. Thrown while loading only; forward() never
/// throws.
class PolicyError : public std::runtime_error {
 public:
  explicit PolicyError(const std::string& sentence) : std::runtime_error(sentence) {}
};

/// Text that came out of a file, made safe for a message: quoted, printable ASCII, cut to `most`
/// characters.
inline std::string printable(std::string_view text, std::size_t most = 60) {
  std::string out = "\"";
  for (const char c : text.substr(0, most)) out += (c >= ' ' && c <= '~') ? c : '?';
  if (text.size() > most) out += "...";
  return out + "\"";
}

}  // namespace tandem::policy
