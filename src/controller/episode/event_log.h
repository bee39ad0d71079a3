#pragma once

#include <lcm/lcm-cpp.hpp>
#include <memory>
#include <optional>
#include <string>
#include <tandem/impedance_gains_t.hpp>
#include <vector>

#include "controller/episode/messages.h"

namespace tandem {

/// The log of record: a standard LCM event log, written in this process, so that nothing can be
/// lost on a network.
///
/// An existing log is continued: it is cut after its last complete episode, and what it already
/// holds is told, so that a run that was killed goes on where it stopped. Used by one thread.
class EventLog {
 public:
  /// What a log already holds.
  struct Past {
    bool has_scenario = false;
    std::vector<episode_end_t> episodes;     ///< complete ones, in order
    std::optional<impedance_gains_t> gains;  ///< the last that were changed while running
    std::string last_policy_path;            ///< of the last POLICY_ANNOUNCE, empty when none
  };

  /// Opens or continues `path`. @throws std::runtime_error with a sentence when that is impossible.
  explicit EventLog(const std::string& path);

  const Past& past() const { return past_; }

  /// Appends one event. A failure to write is remembered and shown by failure().
  void write(const std::string& channel, int64_t utime, const std::vector<uint8_t>& bytes);

  template <typename Message>
  void write(const std::string& channel, int64_t utime, const Message& message) {
    write(channel, utime, encode(message));
  }

  /// Hands everything to the operating system.
  void flush();

  /// Empty, or a sentence (disk full, file vanished) after which the log is incomplete.
  const std::string& failure() const { return failure_; }

 private:
  void recover(const std::string& path);

  std::string path_;
  Past past_;
  std::unique_ptr<lcm::LogFile> file_;
  std::string failure_;
};

}  // namespace tandem
