// tandem_policy: look at a policy file, evaluate it, show the kernels of this machine.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <iostream>
#include <nlohmann/json.hpp>
#include <random>
#include <stdexcept>

#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/kernels/kernels.h"
#include "policy_runtime/policy.h"
#include "policy_runtime/program/write_safetensors.h"

namespace tandem::policy {
namespace {

using Json = nlohmann::ordered_json;

// Inputs for one evaluation after another, of the file's or random ones.
class Inputs {
 public:
  // Normally distributed observations, uniform pixels.
  explicit Inputs(const Policy& policy) : random_(1) {
    observation_.resize(policy.header().observation_size());
    for (const Camera& camera : policy.cameras()) {
      images_.emplace_back(std::size_t(camera.height) * camera.width * 3);
      for (std::uint8_t& pixel : images_.back()) pixel = static_cast<std::uint8_t>(random_());
      pointers_.push_back(images_.back().data());
    }
  }

  Input next() {
    std::normal_distribution<float> normal;
    for (float& value : observation_) value = normal(random_);
    return {.observation = observation_.data(), .images = pointers_.data(), .seed = random_()};
  }

 private:
  std::mt19937 random_;
  std::vector<float> observation_;
  std::vector<std::vector<std::uint8_t>> images_;
  std::vector<const std::uint8_t*> pointers_;
};

// Microseconds of single evaluations, back to back.
std::vector<double> measure(const Policy& policy, int runs) {
  Workspace workspace = policy.make_workspace();
  Inputs inputs(policy);
  std::vector<float> chunk(policy.header().chunk_size());
  std::vector<double> microseconds;
  for (int run = 0; run < runs; ++run) {
    const Input input = inputs.next();
    const auto begin = std::chrono::steady_clock::now();
    const bool usable = policy.forward(input, chunk.data(), workspace);
    const std::chrono::duration<double, std::micro> took = std::chrono::steady_clock::now() - begin;
    if (!usable) throw PolicyError("a normally distributed observation gave no finite chunk.");
    microseconds.push_back(took.count());
  }
  return microseconds;
}

double percentile(std::vector<double> values, double fraction) {
  std::sort(values.begin(), values.end());
  return values[std::min(values.size() - 1, std::size_t(double(values.size()) * fraction))];
}

void info(const std::string& path, int runs, bool as_json) {
  const auto policy = Policy::load(path);
  const Header& header = policy->header();
  const std::vector<double> microseconds = measure(*policy, runs);
  Json cameras = Json::array();
  for (const Camera& each : policy->cameras()) {
    cameras.push_back({{"name", each.name}, {"height", each.height}, {"width", each.width}});
  }
  const Json json = {{"file", path},
                     {"architecture", header.architecture},
                     {"task", header.task},
                     {"method", header.method},
                     {"horizon", header.horizon},
                     {"observation", header.observation_names},
                     {"action", header.action_axes},
                     {"noise_size", policy->noise_size()},
                     {"cameras", cameras},
                     {"execution", Json::parse(header.execution)},
                     {"discount", header.discount},
                     {"version", header.version},
                     {"env_steps", header.env_steps},
                     {"updates", header.updates},
                     {"episodes_trained_through", header.episodes_trained_through},
                     {"git_revision", header.git_revision},
                     {"kernel", kernel_name()},
                     {"golden_error", policy->golden_error()},
                     {"inference_p50_us", percentile(microseconds, 0.5)},
                     {"inference_p99_us", percentile(microseconds, 0.99)}};
  if (as_json) {
    std::cout << json.dump(2) << "\n";
    return;
  }
  for (const auto& [key, value] : json.items()) {
    std::printf("%-26s %s\n", key.c_str(),
                value.is_string() ? value.get<std::string>().c_str() : value.dump().c_str());
  }
}

// observation (N, O), noise (N, noise_size) if given, image.CAMERA (N, H, W, 3) -> chunk (N, h, A).
// Row n without noise takes the noise of seed n.
void run(const std::string& path, const std::string& input, const std::string& output) {
  const auto policy = Policy::load(path);
  const Header& header = policy->header();
  SafetensorsFile in(input);
  const std::int64_t O = header.observation_size();
  const std::int64_t N = in.shape("observation").front();
  const std::vector<float> observation = in.take("observation", {N, O});
  std::vector<float> noise;
  if (in.contains("noise")) noise = in.take("noise", {N, policy->noise_size()});
  std::vector<std::vector<std::uint8_t>> images;
  for (const Camera& each : policy->cameras()) {
    images.push_back(in.take_bytes("image." + each.name, {N, each.height, each.width, 3}));
  }
  in.refuse_unused();

  Workspace workspace = policy->make_workspace();
  std::vector<float> chunk(N * header.chunk_size());
  std::vector<const std::uint8_t*> pointers(images.size());
  for (std::int64_t n = 0; n < N; ++n) {
    for (std::size_t i = 0; i < images.size(); ++i) {
      pointers[i] = images[i].data() + n * (images[i].size() / N);
    }
    const Input row{.observation = &observation[n * O],
                    .images = pointers.data(),
                    .noise = noise.empty() ? nullptr : &noise[n * policy->noise_size()],
                    .seed = std::uint64_t(n)};
    if (!policy->forward(row, &chunk[n * header.chunk_size()], workspace)) {
      throw PolicyError(input + ": observation " + std::to_string(n) +
                        " gave no finite chunk. Correct it.");
    }
  }
  write_safetensors(output, "chunk", {N, header.horizon, header.action_size()}, chunk);
}

void list_kernels() {
  std::cout << "available";
  for (const std::string& name : available_kernels()) std::cout << " " << name;
  std::cout << "\nchosen    " << kernel_name() << "\n";
}

}  // namespace
}  // namespace tandem::policy

int main(int argc, char** argv) {
  using namespace tandem::policy;
  CLI::App app{"Looks at Tandem policy files and evaluates them."};
  app.require_subcommand(1);
  std::string file, input, output, kernel;
  bool as_json = false;
  int runs = 100;
  app.add_option("--kernel", kernel,
                 "instruction set: scalar, AVX2, ... [TANDEM_KERNEL, else the best]");

  CLI::App* info_command = app.add_subcommand("info", "Header, parity error and inference time");
  info_command->add_option("FILE", file, "policy file (.safetensors)")->required();
  info_command->add_option("--runs", runs, "evaluations to time, default 100")
      ->check(CLI::Range(1, 1000000));
  info_command->add_flag("--json", as_json, "print one JSON object");

  CLI::App* run_command = app.add_subcommand("run", "Evaluate the inputs of a safetensors file");
  run_command->add_option("FILE", file, "policy file (.safetensors)")->required();
  run_command
      ->add_option("--input", input,
                   "observation (N, O); noise (N, noise_size), else of seeds 0, 1, ...; "
                   "image.CAMERA (N, H, W, 3) U8")
      ->required();
  run_command->add_option("--output", output, "chunk (N, h, A)")->required();

  app.add_subcommand("kernels", "Kernels this machine can run, best first, and the chosen one");
  CLI11_PARSE(app, argc, argv);

  try {
    if (!kernel.empty()) force_kernel(kernel);
    if (info_command->parsed()) {
      info(file, runs, as_json);
    } else if (run_command->parsed()) {
      run(file, input, output);
    } else {
      list_kernels();
    }
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 2;
  }
  return 0;
}
