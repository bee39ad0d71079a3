#pragma once

#include <lcm/lcm-cpp.hpp>
#include <memory>
#include <string>

namespace tandem {

/// A log of record is one file, or several that follow each other: log.lcm, log.lcm.01, log.lcm.02
/// ... Each is an LCM event log by itself; their bytes in a row are the log that one file would be.

/// Name of file `number` of a log, from 0.
std::string log_file(const std::string& log, size_t number);

/// How many files a log has, 0 when there is none. @throws std::runtime_error with a sentence when
/// one in between is missing.
size_t count_log_files(const std::string& log);

/// Reads all files of a log as one.
class EventReader {
 public:
  /// Where an event ends.
  struct Place {
    size_t file = 0;
    uintmax_t bytes = 0;
  };

  /// @throws std::runtime_error with a sentence when there is no log, or not all of it.
  explicit EventReader(const std::string& log);

  /// The next event, null at the end; valid until the next call. A cut-off tail is none.
  const lcm::LogEvent* next();

  /// Where the event that next() gave ends.
  Place place() const;

 private:
  void open(size_t number);

  std::string log_;
  size_t n_files_;
  size_t number_ = 0;
  std::unique_ptr<lcm::LogFile> file_;
};

}  // namespace tandem
