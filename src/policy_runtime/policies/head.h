#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "policy_runtime/aligned_buffer.h"

namespace tandem::policy {

class ConfigReader;
class SafetensorsFile;

/// A camera whose images a policy looks at: (height, width, 3) bytes, RGB.
struct Camera {
  std::string name;
  int height = 0;
  int width = 0;

  bool operator==(const Camera&) const = default;
};

/// What a head computes from.
struct HeadInput {
  const float* x = nullptr;                     ///< (O) normalised observation, padded with zeros
  const std::uint8_t* const* images = nullptr;  ///< per camera (height, width, 3); null without
  const float* noise = nullptr;                 ///< (samples, noise_size) standard normal numbers
};

/// A policy network: normalised observation, images and noise -> action chunks (h, A). Immutable.
class Head {
 public:
  static constexpr int kMaxHorizon = 256;

  virtual ~Head() = default;

  int horizon() const noexcept { return horizon_; }        ///< h
  int chunk_size() const noexcept { return chunk_size_; }  ///< h A

  /// Standard normal numbers that one sample is made from; 0: every sample is the same.
  virtual int noise_size() const noexcept { return 0; }

  /// The cameras in the order of HeadInput::images.
  virtual const std::vector<Camera>& cameras() const noexcept;

  /// Floats of scratch that forward() needs for so many samples. They are zero before the first.
  virtual std::size_t workspace_size(int samples) const noexcept = 0;

  /// Writes `samples` chunks, row stride padded(chunk_size()). Real-time: no allocation, no lock,
  /// bounded time. What can't be computed comes out as a number that is not finite.
  virtual void forward(const HeadInput& input, int samples, float* chunks,
                       float* workspace) const noexcept = 0;

 protected:
  Head(int horizon, int action_size) : horizon_(horizon), chunk_size_(horizon * action_size) {}

 private:
  int horizon_;
  int chunk_size_;
};

/// What the head's loader needs to know besides its config.
struct HeadSpec {
  std::string prefix;        ///< of its tensors, e.g. "actor"
  int observation_size = 0;  ///< O
  int action_size = 0;       ///< A
};

/// Makes the head `architecture` from its config and takes its tensors. Add a new one here.
/// @throws PolicyError
std::unique_ptr<const Head> load_head(SafetensorsFile& file, const std::string& architecture,
                                      ConfigReader config, const HeadSpec& spec);

}  // namespace tandem::policy
