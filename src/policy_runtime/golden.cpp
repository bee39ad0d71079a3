#include "policy_runtime/golden.h"

#include <algorithm>
#include <cmath>
#include <sstream>

#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/kernels/kernels.h"
#include "policy_runtime/policy.h"

namespace tandem::policy {
namespace {

constexpr std::int64_t kMinimum = 8;  // fewer examples could agree by chance of symmetry

std::size_t image_bytes(const Camera& camera) {
  return std::size_t(camera.height) * camera.width * 3;
}

}  // namespace

Golden::Golden(SafetensorsFile& file, const Policy& policy) : path_(file.path()) {
  const std::vector<std::int64_t> shape = file.shape("golden.observation");
  count_ = shape.empty() ? 0 : shape[0];
  if (count_ < kMinimum) {
    throw PolicyError(path_ + ": it holds " + std::to_string(count_) +
                      " golden examples; at least " + std::to_string(kMinimum) +
                      " are needed. Write the file with the current learner.");
  }
  const Header& header = policy.header();
  observation_ = file.take("golden.observation", {count_, header.observation_size()});
  chunk_ = file.take("golden.chunk", {count_, header.horizon, header.action_size()});
  if (policy.noise_size() > 0) noise_ = file.take("golden.noise", {count_, policy.noise_size()});
  for (const Camera& camera : policy.cameras()) {
    images_.push_back(
        file.take_bytes("golden.image." + camera.name, {count_, camera.height, camera.width, 3}));
  }
}

double Golden::verify(const Policy& policy) const {
  double error = 0.0;
  for (int pass = 0; pass < 2; ++pass) error = std::fmax(error, largest_error(policy));
  if (error > Policy::kGoldenTolerance) {
    std::ostringstream sentence;
    sentence << path_ << ": golden examples differ by " << error << " (kernel " << kernel_name()
             << "); the limit is " << Policy::kGoldenTolerance
             << ". Learner and runtime disagree about the network or its normaliser.";
    throw PolicyError(sentence.str());
  }
  return error;
}

// Relative to the axis's largest action where that is beyond 1 (joints in degrees, say). Infinite
// when an example cannot be evaluated.
double Golden::largest_error(const Policy& policy) const {
  const Header& header = policy.header();
  const int chunk_size = header.chunk_size(), A = header.action_size();
  std::vector<double> unit(A, 1.0);
  for (std::size_t i = 0; i < chunk_.size(); ++i) {
    unit[i % A] = std::fmax(unit[i % A], std::fabs(double{chunk_[i]}));
  }
  Workspace workspace = policy.make_workspace();
  std::vector<float> chunk(chunk_size);
  std::vector<const std::uint8_t*> images(images_.size());
  double largest = 0.0;
  for (std::int64_t n = 0; n < count_; ++n) {
    for (std::size_t i = 0; i < images.size(); ++i) {
      images[i] = images_[i].data() + n * image_bytes(policy.cameras()[i]);
    }
    const Input input{.observation = &observation_[n * header.observation_size()],
                      .images = images.data(),
                      .noise = noise_.empty() ? nullptr : &noise_[n * policy.noise_size()]};
    if (!policy.forward(input, chunk.data(), workspace)) return HUGE_VAL;
    for (int i = 0; i < chunk_size; ++i) {
      const double error = double{chunk[i]} - double{chunk_[n * chunk_size + i]};
      largest = std::fmax(largest, std::fabs(error) / unit[i % A]);
    }
  }
  return largest;
}

}  // namespace tandem::policy
