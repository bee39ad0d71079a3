#include "controller/link/door.h"

#include <algorithm>
#include <cstdint>

namespace tandem {
namespace {

constexpr size_t kFingerprint = 8;

int32_t big_endian(const uint8_t* p) noexcept {
  return static_cast<int32_t>((static_cast<uint32_t>(p[0]) << 24) |
                              (static_cast<uint32_t>(p[1]) << 16) |
                              (static_cast<uint32_t>(p[2]) << 8) | static_cast<uint32_t>(p[3]));
}

// Unicode, table 3-7: which second bytes may follow a first one, and how many more there are.
bool is_utf8(const uint8_t* p, size_t n) noexcept {
  for (size_t i = 0; i < n;) {
    const uint8_t first = p[i++];
    if (first == 0) return false;  // ends a C string early
    if (first < 0x80) continue;
    if (first < 0xc2 || first > 0xf4) return false;
    const size_t more = first < 0xe0 ? 1 : first < 0xf0 ? 2 : 3;
    if (n - i < more) return false;
    const uint8_t low = first == 0xe0 ? 0xa0 : first == 0xf0 ? 0x90 : 0x80;
    const uint8_t high = first == 0xed ? 0x9f : first == 0xf4 ? 0x8f : 0xbf;
    if (p[i] < low || p[i] > high) return false;
    for (size_t k = 1; k < more; ++k) {
      if ((p[i + k] & 0xc0) != 0x80) return false;
    }
    i += more;
  }
  return true;
}

}  // namespace

bool lengths_fit(const void* data, size_t n_bytes, const int* layout, size_t n_parts) noexcept {
  const uint8_t* bytes = static_cast<const uint8_t*>(data);
  size_t left = n_bytes;
  const auto pass = [&](size_t n) {
    if (left < n) return false;
    bytes += n;
    left -= n;
    return true;
  };
  if (!pass(kFingerprint)) return false;
  for (const int* part = layout; part != layout + n_parts; ++part) {
    if (*part > 0) {
      if (!pass(static_cast<size_t>(*part))) return false;
      continue;
    }
    if (left < 4) return false;
    const int32_t n = big_endian(bytes);
    pass(4);
    if (*part == kText) {
      // The length counts the final zero.
      if (n < 1 || static_cast<size_t>(n) > left) return false;
      const size_t length = static_cast<size_t>(n) - 1;
      if (bytes[length] != 0 || !is_utf8(bytes, length)) return false;
      pass(length + 1);
    } else {
      if (n < 0 || static_cast<size_t>(n) > left / 4) return false;
      pass(static_cast<size_t>(n) * 4);
    }
  }
  return left == 0;
}

std::string check_announcement(const policy_announce_t& message) {
  if (message.version < 1) {
    return "version is " + std::to_string(message.version) + "; versions count from 1";
  }
  if (message.path.empty()) return "path is empty";
  const auto is_hex = [](char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); };
  if (message.sha256.size() != 64 ||
      !std::all_of(message.sha256.begin(), message.sha256.end(), is_hex)) {
    return "sha256 is '" + message.sha256 + "'; it must be 64 hex digits, lower case";
  }
  return "";
}

bool is_order(const controller_command_t& message) noexcept {
  return message.order >= controller_command_t::STOP &&
         message.order <= controller_command_t::DISCARD;
}

}  // namespace tandem
