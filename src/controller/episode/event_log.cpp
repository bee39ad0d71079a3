#include "controller/episode/event_log.h"

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <stdexcept>
#include <tandem/policy_announce_t.hpp>

namespace tandem {
namespace {

constexpr size_t kHeaderBytes = 28;  // of an event in an LCM log

}  // namespace

EventLog::EventLog(const std::string& path, const LogLimits& limits)
    : path_(path), limits_(limits) {
  const size_t n_files = count_log_files(path);
  if (n_files > 1 || (std::filesystem::is_regular_file(path) && std::filesystem::file_size(path)))
    recover();
  open(number_);
  if (!file_->good()) {
    throw std::runtime_error(path + ": the event log can't be written (" + std::strerror(errno) +
                             "); choose another folder with --run or mend its permissions.");
  }
}

void EventLog::open(size_t number) {
  number_ = number;
  file_ = std::make_unique<lcm::LogFile>(log_file(path_, number), "a");
}

void EventLog::recover() {
  EventReader log(path_);
  EventReader::Place complete;
  Past seen;
  bool in_episode = false;
  while (const lcm::LogEvent* event = log.next()) {
    bool whole = false;  // what lies before the end of this event will be needed
    if (event->channel == "SCENARIO") {
      seen.has_scenario = whole = true;
    } else if (event->channel == "POLICY_ANNOUNCE") {
      policy_announce_t announce;
      if (announce.decode(event->data, 0, event->datalen) >= 0)
        seen.last_policy_path = announce.path;
    } else if (event->channel == "IMPEDANCE_GAINS") {
      impedance_gains_t gains;
      if (gains.decode(event->data, 0, event->datalen) >= 0) seen.gains = gains;
    } else if (event->channel == "CONTROLLER_FAULT") {
      whole = !in_episode;
    } else if (event->channel == "EPISODE_END") {
      episode_end_t end;
      if (end.decode(event->data, 0, event->datalen) < 0) break;
      seen.episodes.push_back(end);
      in_episode = false;
      whole = true;  // everything of an episode lies before its end
    } else if (event->channel != "PROVENANCE") {
      in_episode = true;
    }
    if (!whole) continue;
    complete = log.place();
    past_ = seen;
  }
  for (size_t n = count_log_files(path_) - 1; n > complete.file; --n)
    std::filesystem::remove(log_file(path_, n));
  number_ = complete.file;
  std::filesystem::resize_file(log_file(path_, number_), complete.bytes);
  for (size_t n = 0; n < number_; ++n)
    earlier_bytes_ += static_cast<int64_t>(std::filesystem::file_size(log_file(path_, n)));
  file_bytes_ = static_cast<int64_t>(complete.bytes);
}

void EventLog::begin_episode() {
  if (limits_.file == 0 || file_bytes_ < limits_.file || !failure_.empty()) return;
  flush();
  earlier_bytes_ += file_bytes_;
  file_bytes_ = 0;
  open(number_ + 1);
  if (!file_->good()) fail();
}

void EventLog::write(const std::string& channel, int64_t utime, const std::vector<uint8_t>& bytes) {
  if (!failure_.empty()) return;
  lcm::LogEvent event;
  event.eventnum = 0;
  event.timestamp = utime;
  event.channel = channel;
  event.datalen = static_cast<int32_t>(bytes.size());
  event.data = const_cast<uint8_t*>(bytes.data());
  file_bytes_ += static_cast<int64_t>(kHeaderBytes + channel.size() + bytes.size());
  if (file_->writeEvent(&event) != 0) flush();
}

void EventLog::flush() {
  if (!failure_.empty()) return;
  FILE* file = file_->getFilePtr();
  if (std::fflush(file) != 0 || std::ferror(file)) fail();
}

void EventLog::fail() {
  failure_ = log_file(path_, number_) + ": the event log can't be written any more (" +
             std::strerror(errno) +
             "); free disk space and start the same command again, it continues after the last "
             "whole episode.";
}

}  // namespace tandem
