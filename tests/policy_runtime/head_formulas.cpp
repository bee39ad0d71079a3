#include "policy_runtime/head_formulas.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "policy_runtime/kernels/kernels.h"
#include "policy_runtime/policy.h"

namespace tandem::policy::testing {
namespace {

using Json = nlohmann::json;

Json common(const PerceptronSpec& spec) {
  return {
      {"hidden", spec.hidden}, {"activation", spec.activation}, {"layer_norm", spec.layer_norm}};
}

std::vector<double> joined(std::vector<double> a, const std::vector<double>& b) {
  a.insert(a.end(), b.begin(), b.end());
  return a;
}

// parameters: mean, then log_std
double tanh_normal(const std::vector<double>& parameters, std::size_t i, double low, double high,
                   double noise) {
  const double log_std = std::min(std::max(parameters[parameters.size() / 2 + i], low), high);
  return std::tanh(parameters[i] + std::exp(log_std) * noise);
}

}  // namespace

Json MlpFormula::config() const {
  Json json = common(spec);
  json.update({{"horizon", sizes.horizon}, {"output", "tanh"}});
  return json;
}

void MlpFormula::add(PolicyFile& file, const std::string& prefix, std::mt19937& random) const {
  add_perceptron(file, prefix, spec, sizes.observation, sizes.chunk(), random);
}

std::vector<double> MlpFormula::evaluate(const PolicyFile& file, const std::string& prefix,
                                         const std::vector<double>& x, const float*) const {
  auto chunk = testing::evaluate(file, prefix, spec, x);
  for (double& value : chunk) value = std::tanh(value);
  return chunk;
}

Json GaussianFormula::config() const {
  Json json = common(spec);
  json.update({{"horizon", sizes.horizon},
               {"log_std_min", low},
               {"log_std_max", high},
               {"output", "tanh"}});
  return json;
}

void GaussianFormula::add(PolicyFile& file, const std::string& prefix, std::mt19937& random) const {
  add_perceptron(file, prefix, spec, sizes.observation, 2 * sizes.chunk(), random);
}

std::vector<double> GaussianFormula::evaluate(const PolicyFile& file, const std::string& prefix,
                                              const std::vector<double>& x,
                                              const float* noise) const {
  const auto parameters = testing::evaluate(file, prefix, spec, x);
  std::vector<double> chunk(sizes.chunk());
  for (std::size_t i = 0; i < chunk.size(); ++i) {
    chunk[i] = tanh_normal(parameters, i, low, high, noise[i]);
  }
  return chunk;
}

Json FlowFormula::config() const {
  Json json = common(spec);
  json.update({{"field", "mlp"},
               {"horizon", sizes.horizon},
               {"steps", steps},
               {"time_features", time_features},
               {"output", "clip"}});
  return json;
}

void FlowFormula::add(PolicyFile& file, const std::string& prefix, std::mt19937& random) const {
  add_perceptron(file, prefix, spec, sizes.observation + sizes.chunk() + time_features,
                 sizes.chunk(), random);
}

std::vector<double> FlowFormula::evaluate(const PolicyFile& file, const std::string& prefix,
                                          const std::vector<double>& x, const float* noise) const {
  std::vector<double> a(noise, noise + sizes.chunk());
  for (int k = 0; k < steps; ++k) {
    std::vector<double> phi;
    for (int i = 1; i <= time_features / 2; ++i) phi.push_back(std::cos(M_PI * i * k / steps));
    for (int i = 1; i <= time_features / 2; ++i) phi.push_back(std::sin(M_PI * i * k / steps));
    const auto v = testing::evaluate(file, prefix, spec, joined(joined(x, a), phi));
    for (std::size_t i = 0; i < a.size(); ++i) a[i] += v[i] / steps;
  }
  for (double& value : a) value = std::min(std::max(value, -1.0), 1.0);
  return a;
}

Json BestOfNFormula::config() const {
  Json json = {{"horizon", sizes.horizon}, {"heads", Json::array()}, {"edit", nullptr}};
  for (const Proposer& each : proposers) {
    json["heads"].push_back({{"architecture", each.head->architecture()},
                             {"config", each.head->config()},
                             {"samples", each.samples}});
  }
  if (edit.used) {
    json["edit"] = common(edit.spec);
    json["edit"].update(
        {{"scale", edit.scale}, {"log_std_min", edit.low}, {"log_std_max", edit.high}});
  }
  json["critic"] = common(critic.spec);
  json["critic"].update({{"members", critic.members}, {"aggregate", critic.aggregate}});
  return json;
}

int BestOfNFormula::noise_size() const {
  int size = 0;
  for (const Proposer& each : proposers) {
    size += each.samples * (each.head->noise_size() + (edit.used ? sizes.chunk() : 0));
  }
  return size;
}

void BestOfNFormula::add(PolicyFile& file, const std::string& prefix, std::mt19937& random) const {
  const int seen = sizes.observation + sizes.chunk();
  for (std::size_t i = 0; i < proposers.size(); ++i) {
    proposers[i].head->add(file, prefix + "." + std::to_string(i), random);
  }
  if (edit.used) add_perceptron(file, "edit", edit.spec, seen, 2 * sizes.chunk(), random);
  for (int m = 0; m < critic.members; ++m) {
    add_perceptron(file, "critic." + std::to_string(m), critic.spec, seen, 1, random);
  }
}

std::vector<std::vector<double>> BestOfNFormula::candidates(const PolicyFile& file,
                                                            const std::string& prefix,
                                                            const std::vector<double>& x,
                                                            const float* noise) const {
  std::vector<std::vector<double>> all;
  for (std::size_t i = 0; i < proposers.size(); ++i) {
    for (int n = 0; n < proposers[i].samples; ++n) {
      const HeadFormula& head = *proposers[i].head;
      all.push_back(head.evaluate(file, prefix + "." + std::to_string(i), x, noise));
      noise += head.noise_size();
    }
  }
  const std::size_t proposed = all.size();
  for (std::size_t n = 0; edit.used && n < proposed; ++n) {
    std::vector<double> edited = all[n];
    const auto parameters = testing::evaluate(file, "edit", edit.spec, joined(x, edited));
    for (std::size_t i = 0; i < edited.size(); ++i) {
      const double change = tanh_normal(parameters, i, edit.low, edit.high, *noise++);
      edited[i] = std::min(std::max(edited[i] + edit.scale * change, -1.0), 1.0);
    }
    all.push_back(edited);
  }
  return all;
}

double BestOfNFormula::score(const PolicyFile& file, const std::vector<double>& x,
                             const std::vector<double>& chunk) const {
  double sum = 0.0, least = INFINITY;
  for (int m = 0; m < critic.members; ++m) {
    const std::string prefix = "critic." + std::to_string(m);
    const double value = testing::evaluate(file, prefix, critic.spec, joined(x, chunk))[0];
    sum += value;
    least = std::min(least, value);
  }
  return critic.aggregate == "mean" ? sum / critic.members : least;
}

std::vector<double> BestOfNFormula::evaluate(const PolicyFile& file, const std::string& prefix,
                                             const std::vector<double>& x,
                                             const float* noise) const {
  std::vector<double> winner;
  double highest = -INFINITY;
  for (const auto& candidate : candidates(file, prefix, x, noise)) {
    const double value = score(file, x, candidate);
    if (value <= highest) continue;
    highest = value;
    winner = candidate;
  }
  return winner;
}

bool BestOfNFormula::on_the_edge(const PolicyFile& file, const std::vector<double>& x,
                                 const float* noise) const {
  std::vector<double> scores;
  for (const auto& each : candidates(file, "actor", x, noise)) {
    scores.push_back(score(file, x, each));
  }
  std::sort(scores.rbegin(), scores.rend());
  return scores.size() > 1 && scores[0] != scores[1] &&  // equal ones tie in any precision
         scores[0] - scores[1] < 1e-3 * std::fmax(1.0, std::fabs(scores[0]));
}

Json GraspFormula::config() const {
  return {{"head", {{"architecture", arm->architecture()}, {"config", arm->config()}}},
          {"critic", common(critic)}};
}

void GraspFormula::add(PolicyFile& file, const std::string& prefix, std::mt19937& random) const {
  arm->add(file, prefix, random);
  add_perceptron(file, "grasp", critic, sizes.observation, 2, random);
}

std::vector<double> GraspFormula::evaluate(const PolicyFile& file, const std::string& prefix,
                                           const std::vector<double>& x, const float* noise) const {
  const auto of_arm = arm->evaluate(file, prefix, x, noise);
  const auto worth = testing::evaluate(file, "grasp", critic, x);  // open, closed
  const std::size_t axes = of_arm.size() / sizes.horizon;
  std::vector<double> chunk;
  for (int step = 0; step < sizes.horizon; ++step) {
    chunk.insert(chunk.end(), of_arm.begin() + step * axes, of_arm.begin() + (step + 1) * axes);
    chunk.push_back(worth[1] > worth[0] ? 1.0 : -1.0);
  }
  return chunk;
}

bool GraspFormula::on_the_edge(const PolicyFile& file, const std::vector<double>& x,
                               const float*) const {
  const auto worth = testing::evaluate(file, "grasp", critic, x);
  return worth[0] != worth[1] && std::fabs(worth[0] - worth[1]) < 1e-3;
}

PolicyFile make_policy(const HeadFormula& head, unsigned seed) {
  std::mt19937 random(seed);
  PolicyFile file = make_file(head.architecture(), head.config().dump(), head.sizes.observation,
                              head.sizes.axes, 1, random);
  head.add(file, "actor", random);
  add_golden(file, head, random);
  return file;
}

void add_golden(PolicyFile& file, const HeadFormula& head, std::mt19937& random) {
  const std::int64_t N = 8;
  const int axes = static_cast<int>(head.sizes.axes.size());
  Tensor observations{{N, head.sizes.observation}, {}}, noises{{N, head.noise_size()}, {}};
  Tensor chunks{{N, head.sizes.horizon, axes}, {}};
  while (chunks.values.size() < std::size_t(N) * head.sizes.chunk()) {
    const auto observation = random_numbers(head.sizes.observation, 1.0f, random);
    const auto noise = random_numbers(head.noise_size(), 1.0f, random);
    const auto x = normalised(file, observation.data());
    if (head.on_the_edge(file, x, noise.data())) continue;
    const auto chunk = head.evaluate(file, "actor", x, noise.data());
    observations.values.insert(observations.values.end(), observation.begin(), observation.end());
    noises.values.insert(noises.values.end(), noise.begin(), noise.end());
    chunks.values.insert(chunks.values.end(), chunk.begin(), chunk.end());
  }
  file.tensors["golden.observation"] = observations;
  file.tensors["golden.chunk"] = chunks;
  if (head.noise_size() > 0) file.tensors["golden.noise"] = noises;
}

std::vector<float> random_numbers(int n, float deviation, std::mt19937& random) {
  std::normal_distribution<float> normal(0.0f, deviation);
  std::vector<float> numbers(n);
  for (float& value : numbers) value = normal(random);
  return numbers;
}

void expect_agreement(const PolicyFile& file, const HeadFormula& head, int runs) {
  const std::string path = write_file(file);
  for (const std::string& kernel : available_kernels()) {
    force_kernel(kernel);
    const auto policy = Policy::load(path);
    EXPECT_EQ(policy->noise_size(), head.noise_size());
    Workspace workspace = policy->make_workspace();
    std::vector<float> chunk(policy->header().chunk_size());
    std::mt19937 random(5);
    int compared = 0;
    for (int run = 0; run < runs; ++run) {
      const auto observation = random_numbers(head.sizes.observation, 2.0f, random);
      const auto noise = random_numbers(head.noise_size(), 1.0f, random);
      const auto x = normalised(file, observation.data());
      if (head.on_the_edge(file, x, noise.data())) continue;
      const auto expected = head.evaluate(file, "actor", x, noise.data());
      ASSERT_TRUE(policy->forward({.observation = observation.data(), .noise = noise.data()},
                                  chunk.data(), workspace));
      for (std::size_t i = 0; i < chunk.size(); ++i) {
        ASSERT_NEAR(chunk[i], expected[i], 1e-5) << kernel << " run " << run << " number " << i;
      }
      ++compared;
    }
    EXPECT_GT(compared, runs / 2);
  }
  force_kernel("simd");
}

std::string refused_config(PolicyFile file, const std::string& pointer, const Json& value) {
  Json config = Json::parse(file.metadata["config"]);
  config[Json::json_pointer(pointer)] = value;
  file.metadata["config"] = config.dump();
  return refusal(write_file(file));
}

}  // namespace tandem::policy::testing
