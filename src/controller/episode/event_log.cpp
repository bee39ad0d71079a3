#include "controller/episode/event_log.h"

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <stdexcept>
#include <tandem/policy_announce_t.hpp>

namespace tandem {

EventLog::EventLog(const std::string& path) : path_(path) {
  if (std::filesystem::is_regular_file(path) && std::filesystem::file_size(path) > 0) recover(path);
  file_ = std::make_unique<lcm::LogFile>(path, "a");
  if (!file_->good()) {
    throw std::runtime_error(path + ": the event log can't be written (" + std::strerror(errno) +
                             "); choose another folder with --run or mend its permissions.");
  }
}

void EventLog::recover(const std::string& path) {
  lcm::LogFile log(path, "r");
  if (!log.good())
    throw std::runtime_error(path + ": the event log of the earlier run can't be read.");
  uintmax_t complete_bytes = 0;
  Past seen;
  while (const lcm::LogEvent* event = log.readNextEvent()) {
    if (event->channel == "SCENARIO") {
      seen.has_scenario = true;
    } else if (event->channel == "POLICY_ANNOUNCE") {
      policy_announce_t announce;
      if (announce.decode(event->data, 0, event->datalen) >= 0)
        seen.last_policy_path = announce.path;
    } else if (event->channel == "IMPEDANCE_GAINS") {
      impedance_gains_t gains;
      if (gains.decode(event->data, 0, event->datalen) >= 0) seen.gains = gains;
    } else if (event->channel == "EPISODE_END") {
      episode_end_t end;
      if (end.decode(event->data, 0, event->datalen) < 0) break;
      seen.episodes.push_back(end);
    } else {
      continue;
    }
    // The log is complete up to here: everything of an episode lies before its EPISODE_END.
    if (event->channel == "SCENARIO" || event->channel == "EPISODE_END") {
      complete_bytes = static_cast<uintmax_t>(ftello(log.getFilePtr()));
      past_ = seen;
    }
  }
  std::filesystem::resize_file(path, complete_bytes);
}

void EventLog::write(const std::string& channel, int64_t utime, const std::vector<uint8_t>& bytes) {
  if (!failure_.empty()) return;
  lcm::LogEvent event;
  event.eventnum = 0;
  event.timestamp = utime;
  event.channel = channel;
  event.datalen = static_cast<int32_t>(bytes.size());
  event.data = const_cast<uint8_t*>(bytes.data());
  if (file_->writeEvent(&event) != 0) flush();
}

void EventLog::flush() {
  if (!failure_.empty()) return;
  FILE* file = file_->getFilePtr();
  if (std::fflush(file) != 0 || std::ferror(file)) {
    failure_ = path_ + ": the event log can't be written any more (" + std::strerror(errno) +
               "); free disk space and start the same command again, it continues after the last "
               "whole episode.";
  }
}

}  // namespace tandem
