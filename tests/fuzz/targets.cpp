#include "fuzz/targets.h"

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>

#include "controller/link/door.h"
#include "fuzz/policy_files.h"
#include "fuzz/session.h"
#include "intervention/command_check.h"

namespace tandem::fuzz {
namespace {

template <typename Message>
Bytes encode(const Message& message) {
  Bytes bytes(static_cast<size_t>(message.getEncodedSize()));
  message.encode(bytes.data(), 0, static_cast<int>(bytes.size()));
  return bytes;
}

// What is decoded must encode to the same bytes again: nothing was read that was not there.
template <typename Message>
bool decode_back(const uint8_t* data, size_t size, Message& message) {
  if (!decode(data, size, message)) return false;
  const Bytes again = encode(message);
  if (again.size() != size || std::memcmp(again.data(), data, size) != 0) {
    fail("a message that was accepted encodes to other bytes than came in");
  }
  return true;
}

// ---- TELEOP_COMMAND, IMPEDANCE_GAINS: what is accepted goes through the control loop

std::vector<Bytes> teleop_seeds() {
  std::vector<Bytes> seeds;
  for (int i = 0; i < 16; ++i) {
    teleop_command_t m{};
    m.episode_answered = m.tick_answered = -1;
    m.device_twist[i % 6] = i < 6 ? 1.0 : i < 12 ? -1.0 : 0.3;
    m.device_gripper = i % 2 ? 1.0 : -1.0;
    m.engaged = i != 15;
    m.operator_id = i % 3 ? "keyboard" : "";
    seeds.push_back(encode(m));
  }
  return seeds;
}

// Ends of a range come as often as all that lies between.
double bold(Random& random, double low, double high) {
  switch (random.next() % 4) {
    case 0:
      return low;
    case 1:
      return high;
    default:
      return random.uniform(low, high);
  }
}

Bytes draw_teleop(Random& random) {
  teleop_command_t m{};
  m.episode_answered = m.tick_answered = -1;
  for (double& value : m.device_twist) value = bold(random, -1.0, 1.0);
  m.device_gripper = bold(random, -1.0, 1.0);
  m.engaged = random.next() % 4 != 0;
  return encode(m);
}

bool take_teleop(const uint8_t* data, size_t size) {
  teleop_command_t message;
  HumanCommand command;
  if (!decode_back(data, size, message) || check_command(message, command) != nullptr) return false;
  Session::get().hear(command);
  return true;
}

std::vector<Bytes> gains_seeds() {
  std::vector<Bytes> seeds;
  for (int i = 0; i < 8; ++i) {
    ImpedanceGains gains = Session::get().gains();
    gains.tool_axes = i % 2;
    gains.stiffness *= i < 4 ? 1.0 : 0.1 * i;
    if (i % 3 == 1) gains.stiffness(0, 4) = gains.stiffness(4, 0) = 20.0;
    if (i == 3) gains.clip_low.setZero();
    impedance_gains_t m = to_message(gains, 0);
    if (i > 5) m.damping_ratio = 0.5;
    seeds.push_back(encode(m));
  }
  return seeds;
}

Bytes draw_gains(Random& random) {
  ImpedanceGains gains = Session::get().gains();
  Matrix6 turn;
  for (double& entry : turn.reshaped()) entry = random.uniform(-1.0, 1.0);
  const double share = random.next() % 2 ? 0.0 : random.uniform(0.0, 1.0);
  for (int i = 0; i < 6; ++i) {
    const double largest = i < 3 ? gain_limit::kStiffness : gain_limit::kAngularStiffness;
    gains.stiffness(i, i) = bold(random, 0.0, largest / (1.0 + share));
    gains.clip_low[i] = bold(random, 0.0, gain_limit::kClip);
    gains.clip_high[i] = bold(random, 0.0, gain_limit::kClip);
  }
  // Coupled axes: K = S (1 + share (T T' / |T T'|)) S is positive for every T.
  const Matrix6 root = gains.stiffness.cwiseSqrt();
  const Matrix6 coupling = turn * turn.transpose();
  gains.stiffness =
      root * (Matrix6::Identity() + share * coupling / coupling.norm()) * root.transpose();
  gains.tool_axes = random.next() % 2;
  impedance_gains_t m = to_message(gains, 0);
  if (random.next() % 4 != 0) m.damping_ratio = bold(random, 0.0, gain_limit::kDampingRatio);
  return encode(m);
}

bool take_gains(const uint8_t* data, size_t size) {
  impedance_gains_t message;
  if (!decode_back(data, size, message)) return false;
  ImpedanceGains gains;
  Session& session = Session::get();
  if (!gains_from(message, session.gains(), gains).empty()) return false;
  session.set_gains(gains);
  return true;
}

// ---- messages that only pass the door and a check of their values

std::vector<Bytes> command_seeds() {
  std::vector<Bytes> seeds;
  for (int order = 1; order <= 4; ++order) {
    controller_command_t m{};
    m.order = static_cast<int8_t>(order);
    m.reason = "because \u00fc";
    seeds.push_back(encode(m));
  }
  return seeds;
}

bool take_command(const uint8_t* data, size_t size) {
  controller_command_t message;
  return decode_back(data, size, message) && is_order(message);
}

std::vector<Bytes> announce_seeds() {
  policy_announce_t m{};
  m.version = 3;
  m.path = "policies/policy_000003.safetensors";
  m.n_bytes = 700'000;
  m.sha256 = std::string(64, 'a');
  return {encode(m)};
}

bool take_announce(const uint8_t* data, size_t size) {
  policy_announce_t message;
  return decode_back(data, size, message) && check_announcement(message).empty();
}

std::vector<Bytes> ack_seeds() {
  episode_ack_t m{};
  m.episode_acknowledged = 7;
  return {encode(m)};
}

bool take_ack(const uint8_t* data, size_t size) {
  episode_ack_t message;
  return decode_back(data, size, message);
}

std::vector<Bytes> request_seeds() {
  std::vector<Bytes> seeds;
  for (const int n : {0, 1, 5, 300}) {
    episode_request_t m{};
    m.episode_requested = 4;
    m.n_missing = n;
    for (int i = 0; i < n; ++i) m.missing_steps.push_back(i);
    seeds.push_back(encode(m));
  }
  return seeds;
}

bool take_request(const uint8_t* data, size_t size) {
  episode_request_t message;
  if (!decode_back(data, size, message)) return false;
  if (message.missing_steps.size() != static_cast<size_t>(message.n_missing)) {
    fail("an accepted request lists as many steps as it says");
  }
  return true;
}

std::vector<Bytes> learner_seeds() {
  learner_status_t m{};
  m.method = "tandem";
  m.win_share = std::nan("");
  return {encode(m)};
}

bool take_learner(const uint8_t* data, size_t size) {
  learner_status_t message;
  return decode_back(data, size, message);
}

}  // namespace

const std::vector<Target>& targets() {
  static const std::vector<Target> all = {
      {"TELEOP_COMMAND", teleop_seeds, take_teleop, draw_teleop},
      {"IMPEDANCE_GAINS", gains_seeds, take_gains, draw_gains},
      {"CONTROLLER_COMMAND", command_seeds, take_command, nullptr},
      {"POLICY_ANNOUNCE", announce_seeds, take_announce, nullptr},
      {"EPISODE_ACK", ack_seeds, take_ack, nullptr},
      {"EPISODE_REQUEST", request_seeds, take_request, nullptr},
      {"LEARNER_STATUS", learner_seeds, take_learner, nullptr},
      {"POLICY_FILE", policy_seeds, take_policy, draw_policy}};
  return all;
}

const Target* find_target(const std::string& name) {
  for (const Target& target : targets()) {
    if (name == target.name) return &target;
  }
  return nullptr;
}

void fail(const char* promise) {
  std::fprintf(stderr, "broken promise: %s\n", promise);
  std::abort();
}

}  // namespace tandem::fuzz
