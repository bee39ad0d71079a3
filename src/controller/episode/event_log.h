#pragma once

#include <lcm/lcm-cpp.hpp>
#include <memory>
#include <optional>
#include <string>
#include <tandem/impedance_gains_t.hpp>
#include <vector>

#include "controller/episode/log_files.h"
#include "controller/episode/messages.h"

namespace tandem {

/// How much a log may take, bytes; 0 = no limit.
struct LogLimits {
  int64_t file = 0;   ///< the next episode begins in a new file once the last one has so many
  int64_t quota = 0;  ///< of all files; see EventLog::full()
};

/// The log of record: a standard LCM event log, written in this process, so that nothing can be
/// lost on a network.
///
/// An existing log is continued: it is cut after its last complete episode, and what it already
/// holds is told, so that a run that was killed goes on where it stopped. Nothing is ever deleted
/// but what that cut takes. Used by one thread.
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
  explicit EventLog(const std::string& path, const LogLimits& limits = {});

  const Past& past() const { return past_; }

  /// Call between two episodes: each lies in one file, whole.
  void begin_episode();

  /// Of all files so far.
  int64_t bytes() const { return earlier_bytes_ + file_bytes_; }
  /// The quota is used up: its owner writes what learning and resuming need, and nothing else.
  bool full() const { return limits_.quota > 0 && bytes() >= limits_.quota; }

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
  void recover();
  void open(size_t number);
  void fail();

  std::string path_;  // of the first file
  LogLimits limits_;
  size_t number_ = 0;          // of the file that is written
  int64_t earlier_bytes_ = 0;  // of the files before it
  int64_t file_bytes_ = 0;
  Past past_;
  std::unique_ptr<lcm::LogFile> file_;
  std::string failure_;
};

}  // namespace tandem
