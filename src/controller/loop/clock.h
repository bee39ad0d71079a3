#pragma once

#include <ctime>
#include <string>

#include "base/signal.h"
#include "controller/loop/control_settings.h"
#include "controller/loop/status_board.h"

namespace tandem {

/// Wall-clock pacing of the control thread: absolute deadlines, 1 ms apart.
class RealtimeClock {
 public:
  static constexpr int64_t kPeriodNs = 1'000'000;

  explicit RealtimeClock(StatusBoard& board) : board_(board) {}

  /// The next deadline is one period from now.
  void restart() noexcept { deadline_ns_ = monotonic_ns() + kPeriodNs; }

  /// Sleeps until the deadline. @returns how many whole cycles were missed before it could run
  /// again.
  int wait() noexcept {
    const timespec until{static_cast<time_t>(deadline_ns_ / 1'000'000'000),
                         static_cast<long>(deadline_ns_ % 1'000'000'000)};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr);
    const int64_t late_ns = monotonic_ns() - deadline_ns_;
    board_.wakeup.add_ns(late_ns);
    const int missed = static_cast<int>(late_ns / kPeriodNs);
    deadline_ns_ += (missed + 1) * kPeriodNs;
    if (missed > 0) board_.overruns += missed;
    return missed;
  }

 private:
  StatusBoard& board_;
  int64_t deadline_ns_ = 0;
};

/// Asks for SCHED_FIFO for the calling thread. @returns empty, or why it is not allowed.
std::string ask_for_priority(int priority);

/// Makes the calling thread the control thread: SCHED_FIFO, memory locked and never given back, its
/// stack touched, on one core if the settings name one, and no deep sleep of the processor while
/// the process lives. What the machine does not allow is said once on stderr, each with its remedy;
/// the run goes on without.
void become_realtime(const RealtimeSettings& settings);

}  // namespace tandem
