#pragma once

#include "controller/rig.h"

namespace tandem::fuzz {

/// The whole control side on the peg task, at the mercy of whoever speaks to it: every command or
/// set of gains is followed by a few ticks of the real loop with physics, and every torque is held
/// against the limits. The motion goes on from input to input, so that effects can pile up; an
/// episode lasts kInputs inputs, or until a fault. Its course depends on the inputs alone: the same
/// inputs in the same order end the same way.
class Session {
 public:
  static constexpr int kTicks = 4;     ///< after each input
  static constexpr int kInputs = 250;  ///< an episode of 1 s

  /// The one of this process, made on first use.
  static Session& get();

  void hear(const HumanCommand& command);
  void set_gains(const ImpedanceGains& gains);

  /// Gains as configured.
  const ImpedanceGains& gains() const { return rig_.control.gains; }

  int64_t ticks() const { return ticks_; }    ///< checked so far
  int64_t faults() const { return faults_; }  ///< episodes that ended in a declared fault

 private:
  Session() = default;
  void begin();
  void run();
  void begin_step();
  void check(const JointVector& before);

  testing::Rig rig_;
  int inputs_ = kInputs;  // the first input begins an episode
  int ticks_of_step_ = 0;
  uint64_t episode_ = 0;
  int64_t ticks_ = 0, faults_ = 0;
};

}  // namespace tandem::fuzz
