#pragma once

#include "fuzz/targets.h"

/// POLICY_FILE: sound files of every kind of policy, and files that were sound before a few of
/// their numbers, names or bytes were changed.
namespace tandem::fuzz {

/// Small sound files, one a kind of head; all load.
std::vector<Bytes> policy_seeds();

/// A seed with one to three changes to its metadata, tensors or bytes.
Bytes draw_policy(Random& random);

/// Loads the file; evaluates what was accepted at ordinary, huge and missing numbers.
bool take_policy(const uint8_t* data, size_t size);

}  // namespace tandem::fuzz
