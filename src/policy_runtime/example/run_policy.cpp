// run_policy POLICY.safetensors NUMBER...: the observation's numbers in, the chunk out, a line a
// step.
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <vector>

#include "policy_runtime/policy.h"

int main(int argc, char** argv) try {
  if (argc < 2) throw tandem::policy::PolicyError("usage: run_policy POLICY NUMBER...");
  const auto policy = tandem::policy::Policy::load(argv[1]);  // checks the file and its examples
  const tandem::policy::Header& header = policy->header();
  tandem::policy::Workspace workspace = policy->make_workspace();

  std::vector<float> observation(header.observation_size());
  for (int i = 2; i < argc && i - 2 < header.observation_size(); ++i) {
    observation[i - 2] = std::strtof(argv[i], nullptr);
  }
  std::vector<float> chunk(header.chunk_size());
  if (!policy->forward({.observation = observation.data()}, chunk.data(), workspace)) return 1;

  for (int step = 0; step < header.horizon; ++step) {
    for (int axis = 0; axis < header.action_size(); ++axis) {
      std::printf("%+.6f ", chunk[step * header.action_size() + axis]);
    }
    std::puts("");
  }
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 2;
}
