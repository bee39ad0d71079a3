#pragma once

#include <array>
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
  std::atomic<int64_t> log_bytes{0}, episodes_without_motion{0};
  std::atomic<int32_t> policy_version{0};
  std::atomic<int64_t> teleop_accepted{0}, teleop_rejected{0}, gains_accepted{0}, gains_rejected{0},
      commands_rejected{0}, learner_rejected{0}, policies_rejected{0}, episodes_unacknowledged{0};
  std::atomic<int64_t> last_teleop_us{-1}, last_learner_us{-1}, last_chunk_us{-1},
      link_alive_us{-1};  ///< monotonic wall clock, -1 = never
  std::atomic<int32_t> fault{0}, faults_in_a_row{0};

  // Of the control loop, once a step.
  std::array<std::atomic<int8_t>, 3> grades{};
  std::atomic<int64_t> chunks_taken{0}, chunks_late{0};
  std::array<std::atomic<int64_t>, 6> chunks_refused{};
  std::array<std::atomic<int32_t>, 2> policy_latency_ticks{};
  std::array<std::atomic<int64_t>, 6> limited_ticks{};
  std::atomic<int64_t> starved_ticks{0}, allocations{0};

  // Of the camera and policy threads.
  std::atomic<int64_t> camera_frames{0}, camera_late{0};

  // Orders from outside.
  std::atomic<bool> stop{false};     ///< end in order: a signal or a STOP command
  std::atomic<bool> estop{false};    ///< hold the arm now; cleared by recovery
  std::atomic<bool> recover{false};  ///< clear the latched fault
  std::atomic<bool> discard{false};  ///< end the running episode
  Histogram tick_time;               ///< waking up to torque ready
  Histogram robot_time;              ///< the simulated robot's own cycle
  Histogram wakeup;                  ///< lateness
  Histogram camera_time{20'000};     ///< one frame, from the scene's state to pixels and JPEG

  void wait_for(const std::string& what) {
    const std::lock_guard lock(mutex_);
    waiting_for_ = what;
  }
  void rejected(const std::string& why) {
    const std::lock_guard lock(mutex_);
    last_rejection_ = why;
  }
  std::string last_rejection() const {
    const std::lock_guard lock(mutex_);
    return last_rejection_;
  }
  std::string waiting_for() const {
    const std::lock_guard lock(mutex_);
    return waiting_for_;
  }

 private:
  mutable std::mutex mutex_;
  std::string waiting_for_, last_rejection_;
};

}  // namespace tandem
