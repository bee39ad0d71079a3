// libFuzzer's side of the targets: `tandem_fuzz --target=TELEOP_COMMAND -runs=1000000 -seed=1`.
// Without corpus files it starts from the target's own seeds. The same seed gives the same inputs.

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

#include "fuzz/session.h"
#include "fuzz/targets.h"

namespace {

using tandem::fuzz::Bytes;

constexpr size_t kFingerprint = 8;  // bytes of an LCM message that name its type

const tandem::fuzz::Target* target = nullptr;
int64_t inputs = 0, accepted = 0;

void report() {
  std::fprintf(stderr, "%s: %lld inputs, %lld accepted", target->name,
               static_cast<long long>(inputs), static_cast<long long>(accepted));
  if (target == tandem::fuzz::find_target("TELEOP_COMMAND") ||
      target == tandem::fuzz::find_target("IMPEDANCE_GAINS")) {
    const auto& session = tandem::fuzz::Session::get();
    std::fprintf(stderr, ", %lld ticks within limits, %lld faults",
                 static_cast<long long>(session.ticks()), static_cast<long long>(session.faults()));
  }
  std::fprintf(stderr, "\n");
}

}  // namespace

extern "C" size_t LLVMFuzzerMutate(uint8_t* data, size_t size, size_t max_size);

extern "C" int LLVMFuzzerInitialize(int* argc, char*** argv) {
  const std::string option = "--target=";
  for (int i = 1; i < *argc; ++i) {
    if (std::strncmp((*argv)[i], option.c_str(), option.size()) == 0) {
      target = tandem::fuzz::find_target((*argv)[i] + option.size());
      std::copy(*argv + i + 1, *argv + *argc, *argv + i);
      --*argc;
      break;
    }
  }
  if (!target) {
    std::fprintf(stderr, "give --target=NAME, one of:");
    for (const auto& each : tandem::fuzz::targets()) std::fprintf(stderr, " %s", each.name);
    std::fprintf(stderr, "\n");
    std::exit(2);
  }
  (void)target->seeds();  // sets up what they need before the clock runs
  std::atexit(report);
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  ++inputs;
  accepted += target->take(data, size);
  return 0;
}

extern "C" size_t LLVMFuzzerCustomMutator(uint8_t* data, size_t size, size_t max_size,
                                          unsigned seed) {
  static const std::vector<Bytes> seeds = target->seeds();
  tandem::Random random{seed};
  if (target->draw && random.next() % 2 == 0) {
    const Bytes drawn = target->draw(random);
    std::copy_n(drawn.begin(), std::min(drawn.size(), max_size), data);
    return std::min(drawn.size(), max_size);
  }
  const bool is_message = std::strcmp(target->name, "POLICY_FILE") != 0;
  const Bytes& start = seeds[random.next() % seeds.size()];
  if ((size < kFingerprint || random.next() % 64 == 0) && start.size() <= max_size) {
    std::copy(start.begin(), start.end(), data);
    size = start.size();
  }
  // A message of another type is refused at its first bytes; do not spend most inputs on that.
  if (!is_message || random.next() % 32 == 0 || size <= kFingerprint) {
    return LLVMFuzzerMutate(data, size, max_size);
  }
  return kFingerprint +
         LLVMFuzzerMutate(data + kFingerprint, size - kFingerprint, max_size - kFingerprint);
}
