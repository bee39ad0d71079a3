// tandem_policy: look at a policy file, evaluate it, show the kernels of this machine.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>
#include <random>
#include <stdexcept>

#include "policy_runtime/kernels/kernels.h"
#include "policy_runtime/policy.h"

namespace tandem::policy {
namespace {

using Json = nlohmann::ordered_json;

struct Latency {
  double p50_us, p99_us;
};

// Times single evaluations, back to back, on random observations.
Latency measure(const Policy& policy, int runs) {
  Workspace workspace = policy.make_workspace();
  std::vector<float> observation(policy.header().observation_size());
  std::vector<float> chunk(policy.header().chunk_size());
  std::vector<double> microseconds;
  std::mt19937 random(1);
  std::normal_distribution<float> normal;
  for (int run = 0; run < runs; ++run) {
    std::generate(observation.begin(), observation.end(), [&] { return normal(random); });
    const auto begin = std::chrono::steady_clock::now();
    const bool usable =
        policy.forward({.observation = observation.data()}, chunk.data(), workspace);
    const std::chrono::duration<double, std::micro> took = std::chrono::steady_clock::now() - begin;
    if (!usable) throw PolicyError("a normally distributed observation gave no finite chunk.");
    microseconds.push_back(took.count());
  }
  std::sort(microseconds.begin(), microseconds.end());
  return {microseconds[microseconds.size() / 2], microseconds[microseconds.size() * 99 / 100]};
}

void info(const std::string& path, bool as_json) {
  const auto policy = Policy::load(path);
  const Header& header = policy->header();
  const Latency latency = measure(*policy, 1000);
  const Json json = {{"file", path},
                     {"architecture", header.architecture},
                     {"task", header.task},
                     {"method", header.method},
                     {"horizon", header.horizon},
                     {"observation", header.observation_names},
                     {"action", header.action_axes},
                     {"execution", Json::parse(header.execution)},
                     {"discount", header.discount},
                     {"version", header.version},
                     {"env_steps", header.env_steps},
                     {"updates", header.updates},
                     {"episodes_trained_through", header.episodes_trained_through},
                     {"git_revision", header.git_revision},
                     {"kernel", kernel_name()},
                     {"golden_error", policy->golden_error()},
                     {"inference_p50_us", latency.p50_us},
                     {"inference_p99_us", latency.p99_us}};
  if (as_json) {
    std::cout << json.dump(2) << "\n";
    return;
  }
  for (const auto& [key, value] : json.items()) {
    std::printf("%-26s %s\n", key.c_str(),
                value.is_string() ? value.get<std::string>().c_str() : value.dump().c_str());
  }
}

// {"observation": [[O numbers], ...]} -> {"chunk": [[[A numbers], ... h], ...]}
void run(const std::string& path, const std::string& input, const std::string& output) {
  const auto policy = Policy::load(path);
  const Header& header = policy->header();
  Workspace workspace = policy->make_workspace();
  std::vector<float> chunk(header.chunk_size());

  std::ifstream in(input);
  if (!in) throw PolicyError(input + ": it cannot be read. Check the path.");
  const Json json = Json::parse(in);
  Json chunks = Json::array();
  for (const Json& row : json.at("observation")) {
    const auto observation = row.get<std::vector<float>>();
    if (static_cast<int>(observation.size()) != header.observation_size()) {
      throw PolicyError(input + ": an observation has " + std::to_string(observation.size()) +
                        " numbers; this policy takes " + std::to_string(header.observation_size()) +
                        ". Compare with tandem_policy info.");
    }
    if (!policy->forward({.observation = observation.data()}, chunk.data(), workspace)) {
      throw PolicyError(input + ": an observation is not finite. Correct it.");
    }
    Json steps = Json::array();
    for (auto step = chunk.begin(); step != chunk.end(); step += header.action_size()) {
      steps.push_back(std::vector<float>(step, step + header.action_size()));
    }
    chunks.push_back(std::move(steps));
  }

  std::ofstream out(output);
  out << Json{{"chunk", std::move(chunks)}}.dump() << "\n";
  if (!out.flush()) throw PolicyError(output + ": it cannot be written. Check folder and disk.");
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
  CLI::App app{"Looks at Tandem policy files and evaluates them. TANDEM_KERNEL forces a kernel."};
  app.require_subcommand(1);
  std::string file, input, output;
  bool as_json = false;

  CLI::App* info_command = app.add_subcommand("info", "Header, parity error and inference time");
  info_command->add_option("FILE", file, "policy file (.safetensors)")->required();
  info_command->add_flag("--json", as_json, "print one JSON object");

  CLI::App* run_command = app.add_subcommand("run", "Evaluate observations from a JSON file");
  run_command->add_option("FILE", file, "policy file (.safetensors)")->required();
  run_command->add_option("--input", input, "{\"observation\": [[O], ...]}")->required();
  run_command->add_option("--output", output, "{\"chunk\": [[[A], ...h], ...]}")->required();

  app.add_subcommand("kernels", "Kernels this machine can run, best first, and the chosen one");
  CLI11_PARSE(app, argc, argv);

  try {
    if (info_command->parsed()) {
      info(file, as_json);
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
