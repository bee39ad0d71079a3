#include "policy_runtime/policy.h"

#include <cmath>
#include <cstdint>
#include <sstream>
#include <vector>

#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/kernels/kernels.h"
#include "policy_runtime/policies/mlp.h"

namespace tandem::policy {
namespace {

constexpr std::int64_t kGoldenMinimum = 8;  // fewer examples could agree by chance of symmetry

std::unique_ptr<Policy> build(SafetensorsFile& file, Header header) {
  if (header.architecture == "mlp") return load_mlp(file, std::move(header));
  throw PolicyError(file.path() + ": architecture is " + printable(header.architecture) +
                    "; this runtime knows mlp. Train with a method that writes one of these.");
}

struct Golden {
  std::int64_t count;              // N
  std::vector<float> observation;  // (N, O)
  std::vector<float> chunk;        // (N, h, A)
};

Golden take_golden(SafetensorsFile& file, const Header& header) {
  const std::vector<std::int64_t> shape = file.shape("golden.observation");
  const std::int64_t count = shape.empty() ? 0 : shape[0];
  if (count < kGoldenMinimum) {
    throw PolicyError(file.path() + ": it holds " + std::to_string(count) +
                      " golden examples; at least " + std::to_string(kGoldenMinimum) +
                      " are needed. Write the file with the current learner.");
  }
  return {count, file.take("golden.observation", {count, header.observation_size()}),
          file.take("golden.chunk", {count, header.horizon, header.action_size()})};
}

// Largest |ours - theirs| over all examples; infinite when one cannot be evaluated.
double largest_error(const Policy& policy, const Golden& golden, Workspace& workspace) {
  const int observation_size = policy.header().observation_size();
  const int chunk_size = policy.header().chunk_size();
  std::vector<float> chunk(chunk_size);
  double largest = 0.0;
  for (std::int64_t n = 0; n < golden.count; ++n) {
    if (!policy.forward(&golden.observation[n * observation_size], chunk.data(), workspace)) {
      return HUGE_VAL;
    }
    for (int i = 0; i < chunk_size; ++i) {
      const double error = double{chunk[i]} - double{golden.chunk[n * chunk_size + i]};
      largest = std::fmax(largest, std::fabs(error));
    }
  }
  return largest;
}

}  // namespace

std::unique_ptr<const Policy> Policy::load(const std::string& path) {
  kernels();  // a bad TANDEM_KERNEL is refused here, before forward() needs one

  SafetensorsFile file(path);
  std::unique_ptr<Policy> policy = build(file, read_header(file));
  const Golden golden = take_golden(file, policy->header());
  file.refuse_unused();

  // the first pass also brings code and weights into the caches; both must agree
  Workspace workspace = policy->make_workspace();
  for (int pass = 0; pass < 2; ++pass) {
    policy->golden_error_ =
        std::fmax(policy->golden_error_, largest_error(*policy, golden, workspace));
  }
  if (policy->golden_error_ > kGoldenTolerance) {
    std::ostringstream sentence;
    sentence << path << ": golden examples differ by " << policy->golden_error_ << " (kernel "
             << kernel_name() << "); the limit is " << kGoldenTolerance
             << ". Learner and runtime disagree about the network or its normaliser.";
    throw PolicyError(sentence.str());
  }
  return policy;
}

}  // namespace tandem::policy
