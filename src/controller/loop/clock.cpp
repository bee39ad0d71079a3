#include "controller/loop/clock.h"

#include <fcntl.h>
#include <malloc.h>
#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>

namespace tandem {
namespace {

void warn(const char* what, const std::string& why, const char* remedy) {
  std::fprintf(stderr, "warning: %s (%s). %s\n", what, why.c_str(), remedy);
}

// The first touch of a page costs a fault, locked memory or not: pay before the first tick.
void touch_stack() noexcept {
  constexpr size_t kBytes = 256 * 1024;
  unsigned char stack[kBytes];
  for (size_t i = 0; i < kBytes; i += 4096) *const_cast<volatile unsigned char*>(stack + i) = 0;
}

std::string stay_on(int core) {
  cpu_set_t cores;
  CPU_ZERO(&cores);
  CPU_SET(static_cast<size_t>(core), &cores);
  const int error = pthread_setaffinity_np(pthread_self(), sizeof(cores), &cores);
  return error == 0 ? "" : std::strerror(error);
}

// The wish holds as long as the file is open, which is as long as the process lives.
std::string forbid_deep_sleep() {
  const int file = open("/dev/cpu_dma_latency", O_WRONLY | O_CLOEXEC);
  const int32_t longest_us = 0;
  if (file < 0 || write(file, &longest_us, sizeof(longest_us)) != sizeof(longest_us))
    return std::strerror(errno);
  return "";
}

}  // namespace

std::string ask_for_priority(int priority) {
  sched_param parameter{};
  parameter.sched_priority = priority;
  const int error = pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameter);
  return error == 0 ? "" : std::strerror(error);
}

void become_realtime(const RealtimeSettings& settings) {
  if (const std::string why = ask_for_priority(settings.priority); !why.empty()) {
    warn("no real-time priority, so ticks may come late when the machine is busy", why,
         "Run as root, or allow 'rtprio' in /etc/security/limits.conf.");
  }
  mallopt(M_TRIM_THRESHOLD, -1);  // freed memory stays ours, so that it stays locked
  if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0) {
    warn("memory can't be locked, so a page fault may delay a tick", std::strerror(errno),
         "Allow 'memlock' in /etc/security/limits.conf.");
  }
  touch_stack();
  if (settings.core >= 0) {
    if (const std::string why = stay_on(settings.core); !why.empty()) {
      warn("the control thread can't stay on the core of controller.realtime.core", why,
           "Name a core that this process may use, or -1.");
    }
  }
  if (const std::string why = forbid_deep_sleep(); !why.empty()) {
    warn("the processor may sleep deeply between ticks and wake up late", why,
         "Allow writing to /dev/cpu_dma_latency.");
  }
}

}  // namespace tandem
