#include "controller/episode/log_files.h"

#include <algorithm>
#include <filesystem>
#include <stdexcept>

namespace tandem {
namespace {

namespace fs = std::filesystem;

/// Number of a file of this log by its name, 0 when it is none.
size_t number_of(const std::string& name, const std::string& log_name) {
  const std::string prefix = log_name + ".";
  if (name.size() < prefix.size() + 2 || !name.starts_with(prefix)) return 0;
  const std::string digits = name.substr(prefix.size());
  const bool number = std::ranges::all_of(digits, [](char c) { return c >= '0' && c <= '9'; });
  return number && digits.size() <= 9 ? std::stoul(digits) : 0;
}

}  // namespace

std::string log_file(const std::string& log, size_t number) {
  if (number == 0) return log;
  return log + (number < 10 ? ".0" : ".") + std::to_string(number);
}

size_t count_log_files(const std::string& log) {
  size_t n = 0;
  while (fs::exists(log_file(log, n))) ++n;
  const fs::path path(log);
  const fs::path folder = path.has_parent_path() ? path.parent_path() : fs::path(".");
  std::error_code no_folder;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, no_folder)) {
    if (number_of(entry.path().filename(), path.filename()) <= n) continue;
    throw std::runtime_error(log_file(log, n) + " is missing, and " + entry.path().string() +
                             " goes on after it; put it back.");
  }
  return n;
}

EventReader::EventReader(const std::string& log) : log_(log), n_files_(count_log_files(log)) {
  open(0);
}

void EventReader::open(size_t number) {
  number_ = number;
  file_ = std::make_unique<lcm::LogFile>(log_file(log_, number), "r");
  if (!file_->good())
    throw std::runtime_error(log_file(log_, number) + ": the event log cannot be opened.");
}

const lcm::LogEvent* EventReader::next() {
  for (;;) {
    if (const lcm::LogEvent* event = file_->readNextEvent()) return event;
    if (number_ + 1 >= n_files_) return nullptr;
    open(number_ + 1);
  }
}

EventReader::Place EventReader::place() const {
  return {number_, static_cast<uintmax_t>(ftello(file_->getFilePtr()))};
}

}  // namespace tandem
