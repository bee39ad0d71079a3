#pragma once

#include <algorithm>

namespace tandem {

/// Owns alpha, the share of the human in what the arm does: 0 = the policy alone, 1 = the human
/// alone.
///
/// alpha moves in straight ramps of `ramp_in` and `ramp_out` ticks for a full swing; with the
/// default of 50 ticks it passes 0.9 within 45 ms of engaging. Policy and human are blended as
/// *increments* of one commanded pose, so there is no target to jump to: at a hand-over, in either
/// direction, the new hand continues from where the commanded pose is. Real-time.
class Arbiter {
 public:
  /// @param ramp_in,ramp_out ticks (ms), >= 1.
  Arbiter(int ramp_in, int ramp_out) : rise_(1.0 / ramp_in), fall_(1.0 / ramp_out) {}

  /// Starts an episode; a demonstration begins in the human's hands.
  void reset(bool human) noexcept {
    alpha_ = human ? 1.0 : 0.0;
    engaged_ = human;
    took_over_ = released_ = false;
  }

  /// One tick. @returns alpha.
  double step(bool engaged) noexcept {
    took_over_ = engaged && !engaged_;
    released_ = !engaged && engaged_;
    engaged_ = engaged;
    alpha_ = engaged ? std::min(1.0, alpha_ + rise_) : std::max(0.0, alpha_ - fall_);
    return alpha_;
  }

  double alpha() const noexcept { return alpha_; }
  bool engaged() const noexcept { return engaged_; }
  bool took_over() const noexcept { return took_over_; }  ///< in the latest tick
  bool released() const noexcept { return released_; }    ///< in the latest tick

 private:
  double rise_, fall_;
  double alpha_ = 0.0;
  bool engaged_ = false, took_over_ = false, released_ = false;
};

}  // namespace tandem
