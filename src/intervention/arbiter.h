#pragma once

#include <algorithm>
#include <cstdint>

namespace tandem {

/// Owns alpha, the share of the human in what the arm does: 0 = the policy alone, 1 = the human
/// alone.
///
/// alpha moves in straight ramps of `ramp_in` and `ramp_out` ticks for a full swing, and turns
/// round wherever it is when the human changes his mind; with the default of 50 ticks it reaches
/// 0.9 in the 45th tick of engaging, so a ramp_in of up to 55 keeps the promise of 50 ms. It is
/// counted in whole numbers: a swing takes exactly its ticks and ends at exactly 0 or 1. Policy and
/// human are blended as *increments* of one commanded pose, so there is no target to jump to: at a
/// hand-over, in either direction, the new hand continues from where the commanded pose is.
/// Real-time.
class Arbiter {
 public:
  /// @param ramp_in,ramp_out ticks (ms), in [1, 10 000].
  Arbiter(int ramp_in, int ramp_out)
      : rise_(ramp_out), fall_(ramp_in), full_(static_cast<int64_t>(ramp_in) * ramp_out) {}

  /// Starts an episode; a demonstration begins in the human's hands.
  void reset(bool human) noexcept {
    share_ = human ? full_ : 0;
    engaged_ = human;
    took_over_ = released_ = false;
  }

  /// One tick. @returns alpha.
  double step(bool engaged) noexcept {
    took_over_ = engaged && !engaged_;
    released_ = !engaged && engaged_;
    engaged_ = engaged;
    share_ = engaged ? std::min(full_, share_ + rise_) : std::max<int64_t>(0, share_ - fall_);
    return alpha();
  }

  double alpha() const noexcept { return static_cast<double>(share_) / static_cast<double>(full_); }
  bool engaged() const noexcept { return engaged_; }
  bool took_over() const noexcept { return took_over_; }  ///< in the latest tick
  bool released() const noexcept { return released_; }    ///< in the latest tick

 private:
  int64_t rise_, fall_, full_;
  int64_t share_ = 0;  // of full_
  bool engaged_ = false, took_over_ = false, released_ = false;
};

}  // namespace tandem
