/// The policy runtime as a contender of `./tandem bench policy`.
///
///   TANDEM_KERNEL=AVX2 tandem_bench_policy FILE     then orders on stdin, see contender.h

#include <cstdio>
#include <stdexcept>

#include "policy/contender.h"
#include "policy/policy_tensors.h"
#include "policy_runtime/kernels/kernels.h"
#include "policy_runtime/policy.h"

namespace tandem::bench {
namespace {

int contend(const std::string& path) {
  const auto policy = policy::Policy::load(path);
  policy::Workspace workspace = policy->make_workspace();
  const std::vector<Example> examples = PolicyTensors(path).examples();
  std::vector<std::vector<const std::uint8_t*>> images;  // per example, per camera
  for (const Example& example : examples) {
    images.emplace_back();
    for (const auto& image : example.images) images.back().push_back(image.data());
  }
  const nlohmann::json about = {{"kernel", policy::kernel_name()},
                                {"golden_error", policy->golden_error()}};
  return serve(about, static_cast<int>(examples.size()), policy->header().chunk_size(),
               [&](int i, float* chunk) {
                 const policy::Input input = {.observation = examples[i].observation.data(),
                                              .images = images[i].data(),
                                              .noise = examples[i].noise.data()};
                 if (!policy->forward(input, chunk, workspace)) {
                   throw std::runtime_error(path + ": an example gave no finite chunk.");
                 }
               });
}

}  // namespace
}  // namespace tandem::bench

int main(int argc, char** argv) {
  if (argc == 2 && std::string(argv[1]) == "--kernels") {
    std::cout << nlohmann::json(tandem::policy::available_kernels()).dump() << std::endl;
    return 0;
  }
  if (argc != 2) {
    std::fprintf(stderr, "usage: tandem_bench_policy FILE | --kernels\n");
    return 2;
  }
  try {
    return tandem::bench::contend(argv[1]);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
