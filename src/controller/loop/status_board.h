#pragma once

#include <atomic>
#include <mutex>
#include <string>
#include <tandem/controller_status_t.hpp>

#include "controller/loop/histogram.h"

namespace tandem {

/// What the threads of the controller know about its state, for CONTROLLER_STATUS and for stopping
/// in order. The control thread touches only the atomics while the arm moves; the text is for the
/// time between episodes.
struct StatusBoard {
  std::atomic<int8_t> state{controller_status_t::WAITING};
  std::atomic<int8_t> phase{0};
  std::atomic<int64_t> episode{-1}, env_steps{0}, ticks{0}, overruns{0}, records_dropped{0};
  std::atomic<int32_t> policy_version{0};
  std::atomic<int64_t> teleop_accepted{0}, teleop_rejected{0}, policies_rejected{0},
      episodes_unacknowledged{0};
  std::atomic<int64_t> last_teleop_us{-1},
      last_learner_us{-1};         ///< monotonic wall clock, -1 = never
  std::atomic<bool> stop{false};   ///< end in order: a signal or a STOP command
  std::atomic<bool> estop{false};  ///< hold the arm now
  Histogram tick_time, wakeup;

  void wait_for(const std::string& what) {
    const std::lock_guard lock(mutex_);
    waiting_for_ = what;
  }
  std::string waiting_for() const {
    const std::lock_guard lock(mutex_);
    return waiting_for_;
  }

 private:
  mutable std::mutex mutex_;
  std::string waiting_for_;
};

}  // namespace tandem
