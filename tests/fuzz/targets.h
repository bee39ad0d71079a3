#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "base/random.h"

namespace tandem::fuzz {

using Bytes = std::vector<uint8_t>;

/// Something that the controller reads from outside, and what it does with it.
///
/// take() never fails on bad input: bad input is refused, that is the point. It ends the process
/// (fail()) when a promise is broken; crashes and sanitizers say the rest.
struct Target {
  const char* name;               ///< the channel, or POLICY_FILE
  std::vector<Bytes> (*seeds)();  ///< valid inputs to start from; all of them must be accepted
  bool (*take)(const uint8_t* data, size_t size);  ///< @returns whether the input was accepted
  Bytes (*draw)(Random& random);  ///< a wild but mostly valid input, which bytes alone would hardly
                                  ///< hit on; null: seeds do
};

const std::vector<Target>& targets();

/// The target of this name, or null.
const Target* find_target(const std::string& name);

/// Says which promise was broken and aborts, so that every fuzzer takes the input for a crash.
[[noreturn]] void fail(const char* promise);

}  // namespace tandem::fuzz
