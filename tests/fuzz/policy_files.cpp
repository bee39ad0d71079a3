#include "fuzz/policy_files.h"

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>

#include "policy_runtime/act_file.h"
#include "policy_runtime/head_formulas.h"
#include "policy_runtime/policy.h"

namespace tandem::fuzz {
namespace {

using namespace policy::testing;

const std::vector<PolicyFile>& sound_files() {
  static const std::vector<PolicyFile> files = [] {
    const Sizes sizes{.observation = 3, .axes = {"x", "rz"}, .horizon = 2};
    const PerceptronSpec small{.hidden = {5}, .layer_norm = true};
    const TransformerSpec transformer{.model_size = 4, .heads = 2, .feedforward = 3};
    ActSpec act{.transformer = transformer, .tokens = {2, 1}, .latent_size = 2};
    act.sample_latent = true;
    ActSpec sees = act;
    sees.cameras = {{"wrist", 8, 9}};
    const auto flow = std::make_shared<FlowFormula>(sizes, small, 2, 2);
    return std::vector<PolicyFile>{
        make_policy(MlpFormula(sizes, small)),
        make_policy(GaussianFormula(sizes, small)),
        make_policy(*flow),
        make_policy(FlowTransformerFormula(sizes, {transformer, {1, 2}, 2, 2})),
        make_policy(ActFormula(sizes, act)),
        make_policy(ActFormula(sizes, sees)),
        make_policy(BestOfNFormula(sizes, {{flow, 3}}, {small}, {small}))};
  }();
  return files;
}

Bytes bytes_of(const PolicyFile& file) {
  const std::string text = safetensors(file.header(), file.data());
  return {text.begin(), text.end()};
}

size_t any(Random& random, size_t n) { return static_cast<size_t>(random.next() % n); }

template <typename Container>
auto& any_of(Container& container, Random& random) {
  return *std::next(container.begin(), static_cast<long>(any(random, container.size())));
}

// Replaces one of the numbers in a JSON text, or makes its first one the target of a swap.
void change_number(std::string& text, Random& random) {
  static const std::vector<std::string> bold = {
      "0",   "1",     "-1",   "2",   "3",  "7",    "255",        "4096",
      "1e9", "1e308", "-0.0", "1.5", "[]", "null", "2147483648", "18446744073709551615"};
  std::vector<std::pair<size_t, size_t>> numbers;
  for (size_t i = 0; i < text.size(); ++i) {
    if (!std::isdigit(static_cast<unsigned char>(text[i]))) continue;
    const size_t end = std::min(text.find_first_not_of("0123456789.e-", i), text.size());
    numbers.emplace_back(i, end - i);
    i = end;
  }
  if (numbers.empty()) return;
  const auto [at, length] = any_of(numbers, random);
  text.replace(at, length, any_of(bold, random));
}

void change(PolicyFile& file, Random& random) {
  static const std::vector<float> bold = {0.0f,
                                          1.0f,
                                          -1e30f,
                                          3e38f,
                                          1e-42f,
                                          std::numeric_limits<float>::infinity(),
                                          std::numeric_limits<float>::quiet_NaN()};
  static const std::vector<std::string> dtypes = {"F32", "BF16", "U8", "F64", ""};
  auto& [name, tensor] = any_of(file.tensors, random);
  switch (any(random, 9)) {
    case 0:
    case 1:
      return change_number(file.metadata["config"], random);
    case 2:
      return change_number(any_of(file.metadata, random).second, random);
    case 3:
      any_of(file.metadata, random).second = any_of(file.metadata, random).second;
      return;
    case 4:
      tensor.values[any(random, tensor.values.size())] = any_of(bold, random);
      return;
    case 5:
      any_of(tensor.shape, random) = static_cast<std::int64_t>(any(random, 70));
      return;
    case 6:
      tensor.dtype = any_of(dtypes, random);
      return;
    case 7:
      file.tensors.erase(std::string(name));
      return;
    default:
      std::swap(tensor, any_of(file.tensors, random).second);
  }
}

// What is accepted answers every observation: with finite numbers, or with zeros and false.
void evaluate(const policy::Policy& policy) {
  policy::Workspace workspace = policy.make_workspace();
  std::vector<std::vector<uint8_t>> images;
  std::vector<const uint8_t*> pointers;
  for (const policy::Camera& camera : policy.cameras()) {
    images.emplace_back(static_cast<size_t>(camera.height) * camera.width * 3, uint8_t{200});
    pointers.push_back(images.back().data());
  }
  std::vector<float> chunk(policy.header().chunk_size());
  for (const float value : {0.0f, -1.0f, 1e20f, 3e38f, std::numeric_limits<float>::quiet_NaN()}) {
    const std::vector<float> observation(policy.header().observation_size(), value);
    const bool usable =
        policy.forward({.observation = observation.data(), .images = pointers.data(), .seed = 1},
                       chunk.data(), workspace);
    for (const float number : chunk) {
      if (!(usable ? std::isfinite(number) : number == 0.0f)) {
        fail("a chunk is finite, or all zeros when the policy says so");
      }
    }
  }
}

}  // namespace

std::vector<Bytes> policy_seeds() {
  std::vector<Bytes> seeds;
  for (const PolicyFile& file : sound_files()) seeds.push_back(bytes_of(file));
  return seeds;
}

Bytes draw_policy(Random& random) {
  PolicyFile file = any_of(sound_files(), random);
  for (size_t n = 1 + any(random, 3); n > 0 && !file.tensors.empty(); --n) change(file, random);
  Bytes bytes = bytes_of(file);
  if (any(random, 8) == 0) bytes.resize(any(random, bytes.size()));
  if (any(random, 8) == 0 && !bytes.empty()) {
    any_of(bytes, random) = static_cast<uint8_t>(random.next());
  }
  return bytes;
}

bool take_policy(const uint8_t* data, size_t size) {
  static const int file = memfd_create("policy", MFD_CLOEXEC);
  static const std::string path = "/proc/self/fd/" + std::to_string(file);
  if (ftruncate(file, 0) != 0 || pwrite(file, data, size, 0) != static_cast<ssize_t>(size)) {
    fail("the memory file can be written");
  }
  try {
    evaluate(*policy::Policy::load(path));
    return true;
  } catch (const policy::PolicyError&) {
    return false;  // a sentence; anything else that is thrown ends the process
  }
}

}  // namespace tandem::fuzz
