#include "controller/loop/clock.h"

#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>

#include <cerrno>
#include <cstdio>
#include <cstring>

namespace tandem {

void become_realtime(int priority) {
  sched_param parameter{};
  parameter.sched_priority = priority;
  if (const int error = pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameter); error != 0) {
    std::fprintf(stderr,
                 "warning: no real-time priority (%s); ticks may come late when the machine is "
                 "busy. Run as root, or allow "
                 "'rtprio' in /etc/security/limits.conf.\n",
                 std::strerror(error));
  }
  if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0) {
    std::fprintf(
        stderr,
        "warning: memory can't be locked (%s); a page fault may delay a tick. Allow 'memlock'.\n",
        std::strerror(errno));
  }
}

}  // namespace tandem
