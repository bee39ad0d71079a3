#include "fuzz/targets.h"

#include <gtest/gtest.h>

#include "base/random.h"
#include "controller/link/door.h"

namespace tandem::fuzz {
namespace {

/// The fuzzer's targets under ctest: a short run without coverage, with mutations of our own that
/// are the same on every machine. `./tandem test --fuzz N` is the long run.
class Targets : public ::testing::TestWithParam<const char*> {
 protected:
  const Target& target() const { return *find_target(GetParam()); }
};

INSTANTIATE_TEST_SUITE_P(All, Targets,
                         ::testing::Values("TELEOP_COMMAND", "IMPEDANCE_GAINS",
                                           "CONTROLLER_COMMAND", "POLICY_ANNOUNCE", "EPISODE_ACK",
                                           "EPISODE_REQUEST", "LEARNER_STATUS", "POLICY_FILE"),
                         [](const auto& info) { return std::string(info.param); });

void mutate(Bytes& bytes, Random& random) {
  static const uint8_t bold[] = {0x00, 0xff, 0x80, 0x7f, 0x01};
  const auto any = [&](size_t n) { return static_cast<size_t>(random.next() % n); };
  for (size_t n = 1 + any(4); n > 0 && !bytes.empty(); --n) {
    const size_t at = any(bytes.size());
    switch (any(6)) {
      case 0:
        bytes[at] ^= static_cast<uint8_t>(1u << any(8));
        break;
      case 1:
        bytes[at] = static_cast<uint8_t>(random.next());
        break;
      case 2:  // a length, a count or an exponent far out
        for (size_t i = at; i < std::min(bytes.size(), at + 1 + any(4)); ++i) {
          bytes[i] = bold[any(sizeof(bold))];
        }
        break;
      case 3:
        bytes.resize(at);
        break;
      case 4:
        bytes.insert(bytes.end(), 1 + any(16), static_cast<uint8_t>(random.next()));
        break;
      default:
        bytes[at] = bold[any(sizeof(bold))];
    }
  }
}

TEST_P(Targets, MutatedInputsNeverCrashNorMoveTheArmBeyondItsLimits) {
  const std::vector<Bytes> seeds = target().seeds();
  Random random{20, static_cast<uint64_t>(target().name[0])};
  for (int i = 0; i < 2000; ++i) {
    const bool draws = target().draw && i % 2 == 0;
    Bytes bytes = draws ? target().draw(random) : seeds[random.next() % seeds.size()];
    if (!draws && i % 8 != 1) mutate(bytes, random);
    // An own block of exactly this size, so that the address sanitizer sees one byte too far.
    const Bytes input(bytes.begin(), bytes.end());
    target().take(input.data(), input.size());
  }
}

TEST_P(Targets, AcceptEverySeed) {
  for (const Bytes& seed : target().seeds()) EXPECT_TRUE(target().take(seed.data(), seed.size()));
}

template <typename Message>
bool passes(const Bytes& bytes) {
  Message message;
  return decode(bytes.data(), bytes.size(), message);
}

template <typename Message>
Bytes encode(const Message& message) {
  Bytes bytes(static_cast<size_t>(message.getEncodedSize()));
  message.encode(bytes.data(), 0, static_cast<int>(bytes.size()));
  return bytes;
}

void set_int(Bytes& bytes, size_t at, int32_t value) {
  for (int i = 0; i < 4; ++i) bytes[at + i] = static_cast<uint8_t>(value >> (24 - 8 * i));
}

TEST(Door, LayoutsAreThoseOfLcmGen) {
  // The other messages' are in AcceptEverySeed.
  controller_status_t status{};
  status.waiting_for = "the operator";
  EXPECT_TRUE(passes<controller_status_t>(encode(status)));
}

TEST(Door, RefusesTextLengthsThatTheDecoderWouldThrowOn) {
  teleop_command_t m{};
  m.operator_id = "me";
  const Bytes good = encode(m);
  ASSERT_TRUE(passes<teleop_command_t>(good));
  const size_t length_at = good.size() - 3 - 4;
  for (const int32_t length : {0, -1, -5, INT32_MIN, INT32_MAX, 2, 4}) {
    Bytes bad = good;
    set_int(bad, length_at, length);
    EXPECT_FALSE(passes<teleop_command_t>(bad)) << length;
  }
}

TEST(Door, RefusesCountsThatTheDecoderWouldReadBeyondTheMessageFor) {
  episode_request_t m{};
  m.n_missing = 2;
  m.missing_steps = {3, 4};
  const Bytes good = encode(m);
  ASSERT_TRUE(passes<episode_request_t>(good));
  for (const int32_t count : {-1, 1, 3, 0x40000000, 0x40000002, INT32_MIN, INT32_MAX}) {
    Bytes bad = good;
    set_int(bad, 8 + 16, count);
    EXPECT_FALSE(passes<episode_request_t>(bad)) << count;
  }
}

TEST(Door, RefusesTextThatIsNotUtf8) {
  const auto accepts = [](const std::string& reason) {
    controller_command_t m{};
    m.reason = reason;
    return passes<controller_command_t>(encode(m));
  };
  for (const char* good : {"", "stop", "\u00fc", "\u20ac", "\U0001F916"}) {
    EXPECT_TRUE(accepts(good)) << good;
  }
  for (const char* bad : {"\x80", "\xc3", "\xc0\xaf", "\xe0\x80\x80", "\xed\xa0\x80",
                          "\xf5\x80\x80\x80", "\xf4\x90\x80\x80", "ab\xff"}) {
    EXPECT_FALSE(accepts(bad)) << bad;
  }
  EXPECT_FALSE(accepts(std::string("a\0b", 3)));
}

TEST(Door, RefusesAnAnnouncementWithoutDigest) {
  policy_announce_t m{};
  m.version = 1;
  m.path = "p.safetensors";
  m.sha256 = std::string(64, '0');
  EXPECT_EQ(check_announcement(m), "");
  m.sha256 = "";
  EXPECT_NE(check_announcement(m), "");
  m.sha256 = std::string(63, '0') + "G";
  EXPECT_NE(check_announcement(m), "");
  m.sha256 = std::string(64, '0');
  m.version = 0;
  EXPECT_NE(check_announcement(m), "");
}

}  // namespace
}  // namespace tandem::fuzz
