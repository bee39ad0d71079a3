#pragma once

#include <memory>
#include <nlohmann/json.hpp>
#include <random>
#include <string>
#include <vector>

#include "policy_runtime/policy_file.h"

/// The heads as straightforward formulas in double precision that share nothing with the runtime,
/// and the policy files to compare with it.
namespace tandem::policy::testing {

struct Sizes {
  int observation = 7;
  std::vector<std::string> axes = {"x", "y", "rz"};
  int horizon = 2;

  int chunk() const { return horizon * static_cast<int>(axes.size()); }
};

class HeadFormula {
 public:
  explicit HeadFormula(Sizes sizes) : sizes(std::move(sizes)) {}
  virtual ~HeadFormula() = default;

  const Sizes sizes;

  virtual std::string architecture() const = 0;
  virtual nlohmann::json config() const = 0;
  virtual int noise_size() const = 0;

  /// Adds random tensors.
  virtual void add(PolicyFile& file, const std::string& prefix, std::mt19937& random) const = 0;

  /// x (O), noise (noise_size) -> chunk (h A).
  virtual std::vector<double> evaluate(const PolicyFile& file, const std::string& prefix,
                                       const std::vector<double>& x, const float* noise) const = 0;

  /// Whether rounding could change the result altogether.
  virtual bool on_the_edge(const PolicyFile&, const std::vector<double>&, const float*) const {
    return false;
  }
};

class MlpFormula : public HeadFormula {
 public:
  MlpFormula(Sizes sizes, PerceptronSpec spec) : HeadFormula(std::move(sizes)), spec(spec) {}
  const PerceptronSpec spec;

  std::string architecture() const override { return "mlp"; }
  nlohmann::json config() const override;
  int noise_size() const override { return 0; }
  void add(PolicyFile& file, const std::string& prefix, std::mt19937& random) const override;
  std::vector<double> evaluate(const PolicyFile& file, const std::string& prefix,
                               const std::vector<double>& x, const float* noise) const override;
};

class GaussianFormula : public HeadFormula {
 public:
  GaussianFormula(Sizes sizes, PerceptronSpec spec, double log_std_min = -5.0,
                  double log_std_max = 2.0)
      : HeadFormula(std::move(sizes)), spec(spec), low(log_std_min), high(log_std_max) {}
  const PerceptronSpec spec;
  const double low, high;

  std::string architecture() const override { return "gaussian"; }
  nlohmann::json config() const override;
  int noise_size() const override { return sizes.chunk(); }
  void add(PolicyFile& file, const std::string& prefix, std::mt19937& random) const override;
  std::vector<double> evaluate(const PolicyFile& file, const std::string& prefix,
                               const std::vector<double>& x, const float* noise) const override;
};

class FlowFormula : public HeadFormula {
 public:
  FlowFormula(Sizes sizes, PerceptronSpec spec, int steps = 4, int time_features = 6)
      : HeadFormula(std::move(sizes)), spec(spec), steps(steps), time_features(time_features) {}
  const PerceptronSpec spec;
  const int steps, time_features;

  std::string architecture() const override { return "flow"; }
  nlohmann::json config() const override;
  int noise_size() const override { return sizes.chunk(); }
  void add(PolicyFile& file, const std::string& prefix, std::mt19937& random) const override;
  std::vector<double> evaluate(const PolicyFile& file, const std::string& prefix,
                               const std::vector<double>& x, const float* noise) const override;
};

class BestOfNFormula : public HeadFormula {
 public:
  struct Proposer {
    std::shared_ptr<const HeadFormula> head;
    int samples;
  };
  struct Edit {
    PerceptronSpec spec = {};
    bool used = true;
    double scale = 0.3, low = -5.0, high = 2.0;
  };
  struct Critic {
    PerceptronSpec spec = {};
    int members = 2;
    std::string aggregate = "mean";
  };
  BestOfNFormula(Sizes sizes, std::vector<Proposer> proposers, Edit edit, Critic critic)
      : HeadFormula(std::move(sizes)), proposers(proposers), edit(edit), critic(critic) {}
  const std::vector<Proposer> proposers;
  const Edit edit;
  const Critic critic;

  std::string architecture() const override { return "best_of_n"; }
  nlohmann::json config() const override;
  int noise_size() const override;
  void add(PolicyFile& file, const std::string& prefix, std::mt19937& random) const override;
  std::vector<double> evaluate(const PolicyFile& file, const std::string& prefix,
                               const std::vector<double>& x, const float* noise) const override;
  bool on_the_edge(const PolicyFile& file, const std::vector<double>& x,
                   const float* noise) const override;

  /// Every candidate (h A), in order, and its score.
  std::vector<std::vector<double>> candidates(const PolicyFile& file, const std::string& prefix,
                                              const std::vector<double>& x,
                                              const float* noise) const;
  double score(const PolicyFile& file, const std::vector<double>& x,
               const std::vector<double>& chunk) const;
};

/// `arm` has all axes but the last, the gripper.
class GraspFormula : public HeadFormula {
 public:
  GraspFormula(Sizes sizes, std::shared_ptr<const HeadFormula> arm, PerceptronSpec critic)
      : HeadFormula(std::move(sizes)), arm(std::move(arm)), critic(critic) {}
  const std::shared_ptr<const HeadFormula> arm;
  const PerceptronSpec critic;

  std::string architecture() const override { return "grasp"; }
  nlohmann::json config() const override;
  int noise_size() const override { return arm->noise_size(); }
  void add(PolicyFile& file, const std::string& prefix, std::mt19937& random) const override;
  std::vector<double> evaluate(const PolicyFile& file, const std::string& prefix,
                               const std::vector<double>& x, const float* noise) const override;
  bool on_the_edge(const PolicyFile& file, const std::vector<double>& x,
                   const float* noise) const override;
};

/// A sound file: random parameters, golden examples from the formula.
PolicyFile make_policy(const HeadFormula& head, unsigned seed = 1);

/// Writes golden examples from the formula over those there are.
void add_golden(PolicyFile& file, const HeadFormula& head, std::mt19937& random);

/// n normally distributed numbers.
std::vector<float> random_numbers(int n, float deviation, std::mt19937& random);

/// Loads the file under every kernel of this machine and compares `runs` random observations with
/// the formula, to 1e-5.
void expect_agreement(const PolicyFile& file, const HeadFormula& head, int runs);

/// Many evaluations: expects no allocation, the same bits for the same noise (or seed), and others
/// for another seed.
void expect_real_time_and_repeatable(const PolicyFile& file, const HeadFormula& head);

/// The message that loading raises with one value of the config replaced; a JSON pointer tells
/// which.
std::string refused_config(PolicyFile file, const std::string& pointer,
                           const nlohmann::json& value);

}  // namespace tandem::policy::testing
