#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <tandem/controller_command_t.hpp>
#include <tandem/controller_status_t.hpp>
#include <tandem/episode_ack_t.hpp>
#include <tandem/episode_request_t.hpp>
#include <tandem/impedance_gains_t.hpp>
#include <tandem/learner_status_t.hpp>
#include <tandem/policy_announce_t.hpp>
#include <tandem/teleop_command_t.hpp>

/// The door of the link: what every datagram passes before it is decoded.
///
/// lcm-gen's decoders believe the lengths inside a message. A string of length 0, an array of -1 or
/// of 2^30 elements makes them throw through LCM's C code, which ends the process, or read beyond
/// the datagram. So the lengths are walked first, and only bytes that are one whole message of the
/// type reach the decoder.
namespace tandem {

/// How a message lies on the wire after its 8 byte fingerprint, part by part: > 0 so many bytes of
/// fixed size, kText a string, kInts an int32 count and so many int32. tests/fuzz holds each layout
/// against what lcm-gen encodes.
inline constexpr int kText = -1, kInts = -2;

template <typename Message>
inline constexpr std::array<int, 0> kLayout{};
template <>
inline constexpr std::array kLayout<teleop_command_t>{3 * 8 + 6 * 8 + 8 + 1 + 1, kText};
template <>
inline constexpr std::array kLayout<controller_command_t>{8 + 1, kText};
template <>
inline constexpr std::array kLayout<impedance_gains_t>{8 + 1 + 36 * 8 + 8 + 36 * 8 + 2 * 6 * 8};
template <>
inline constexpr std::array kLayout<policy_announce_t>{8 + 4, kText, 8, kText, 8 + 8};
template <>
inline constexpr std::array kLayout<episode_ack_t>{8 + 8};
template <>
inline constexpr std::array kLayout<episode_request_t>{8 + 8, kInts};
template <>
inline constexpr std::array kLayout<learner_status_t>{8, kText, 3 * 8 + 6 * 8 + 4};
template <>
inline constexpr std::array kLayout<controller_status_t>{2 * 8 + 3 + 3 * 8 + 4 + 2 * 8 + 8 * 8 +
                                                             2 * 4 + 3 + 3 * 8 + 7 * 8 + 2 * 8 +
                                                             6 * 8 + 8 + 2 * 4 + 6 * 8 + 6 * 8,
                                                         kText, kText};

/// Whether `n_bytes` at `data` are, by their lengths, one message of this layout: nothing missing,
/// nothing left over, strings that end where they say and are UTF-8 (logs are read by programs that
/// insist on it). The fingerprint is the decoder's business.
bool lengths_fit(const void* data, size_t n_bytes, const int* layout, size_t n_parts) noexcept;

/// Decodes a datagram that nobody vouches for. @returns false, with `message` in any state, when
/// these bytes are not one message of this type. What its values mean is checked elsewhere.
template <typename Message>
bool decode(const void* data, size_t n_bytes, Message& message) noexcept {
  constexpr const auto& layout = kLayout<Message>;
  static_assert(layout.size() > 0, "give the message a layout above");
  return lengths_fit(data, n_bytes, layout.data(), layout.size()) &&
         message.decode(data, 0, static_cast<int>(n_bytes)) == static_cast<int>(n_bytes);
}

/// @returns empty when the announcement can be acted on, else a clause that says what is wrong: a
/// version below 1, no path, a digest that is not 64 hex digits (without one any file would do).
std::string check_announcement(const policy_announce_t& message);

/// Whether the order is one of STOP, ESTOP, RECOVER and DISCARD.
bool is_order(const controller_command_t& message) noexcept;

}  // namespace tandem
