#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace tandem::policy {

class SafetensorsFile;

/// What a policy file says about itself. Everything is required; load() refuses a file that leaves
/// anything out.
struct Header {
  std::string architecture;  ///< "mlp", "act", ...
  std::string task;          ///< e.g. "peg"
  std::string method;        ///< e.g. "tandem"
  int horizon = 0;           ///< h, steps in a chunk, [1, 256]
  std::vector<std::string>
      observation_names;  ///< O names; their order is the order of the observation vector
  std::vector<std::string> action_axes;  ///< A names; columns of a chunk. On our arm: some of x y z
                                         ///< rx ry rz gripper, in that order
  std::string execution;     ///< JSON object: how the controller is to execute the chunks
  double discount = 0.0;     ///< per policy step, (0, 1]
  std::int64_t version = 0;  ///< counts published policies of one run, from 1; 0 = never announced
  std::int64_t env_steps = 0;                  ///< steps the arm had made when this was written
  std::int64_t updates = 0;                    ///< gradient steps behind it
  std::int64_t episodes_trained_through = -1;  ///< last episode it has learnt from; -1 = none
  std::string git_revision;

  int observation_size() const { return static_cast<int>(observation_names.size()); }  ///< O
  int action_size() const { return static_cast<int>(action_axes.size()); }             ///< A
  int chunk_size() const { return horizon * action_size(); }                           ///< h A
};

/// Reads and checks the metadata, except "config" and with it the horizon: those belong to the
/// head.
/// @throws PolicyError for anything missing, unknown, of the wrong kind or out of range.
Header read_header(const SafetensorsFile& file);

}  // namespace tandem::policy
