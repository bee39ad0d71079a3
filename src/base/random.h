#pragma once

#include <cmath>
#include <cstdint>
#include <initializer_list>

namespace tandem {

/// Small seeded generator (SplitMix64). The same keys give the same numbers on every machine, in
/// any order of use: everything random in Tandem draws from a Random keyed by (seed, episode,
/// purpose, ...), never from a shared stream.
class Random {
 public:
  explicit Random(std::initializer_list<uint64_t> keys) noexcept {
    for (const uint64_t key : keys) state_ = mix(state_ ^ mix(key + 0x9e3779b97f4a7c15ull));
  }

  uint64_t next() noexcept { return mix(state_ += 0x9e3779b97f4a7c15ull); }

  double uniform(double low, double high) noexcept {
    return low + (high - low) * (static_cast<double>(next() >> 11) * 0x1.0p-53);
  }

  /// Normal with mean 0 (Box-Muller; the second number is not kept so that the stream has no hidden
  /// state).
  double normal(double standard_deviation) noexcept {
    const double u = 1.0 - uniform(0.0, 1.0);
    return standard_deviation * std::sqrt(-2.0 * std::log(u)) *
           std::cos(6.283185307179586 * uniform(0.0, 1.0));
  }

 private:
  static uint64_t mix(uint64_t x) noexcept {
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ull;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebull;
    return x ^ (x >> 31);
  }

  uint64_t state_ = 0;
};

/// What a stream of random numbers is for; the second key after the episode's seed.
enum class Purpose : uint64_t {
  reset = 1,
  observation = 2,
  exploration = 3,
  operator_episode = 4,
  operator_step = 5,
  robot_faults = 6,
  policy_noise = 7,
  camera = 8,
  light = 9,
  exploration_speed = 10
};

inline Random random_for(uint64_t episode_seed, Purpose purpose, uint64_t index = 0) noexcept {
  return Random{episode_seed, static_cast<uint64_t>(purpose), index};
}

}  // namespace tandem
