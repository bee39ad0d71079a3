#include "controller/task/observation.h"

#include <algorithm>
#include <iterator>

#include "base/random.h"
#include "controller/task/task.h"

namespace tandem {
namespace {

// Groups of six (translation x y z, rotation x y z) in the order in which write() fills its table.
constexpr const char* kGroups[] = {"tool_", "twist_",     "lead_",   "wrench",
                                   "goal_", "goal_fine_", "object_", "object_fine_"};
constexpr int kGroupCount = std::size(kGroups);
constexpr const char* kAxes[] = {"x", "y", "z", "rx", "ry", "rz"};
constexpr const char* kWrench[] = {"force_x",  "force_y",  "force_z",
                                   "moment_x", "moment_y", "moment_z"};

std::vector<std::string> all_terms() {
  std::vector<std::string> names;
  for (int group = 0; group < kGroupCount; ++group) {
    for (int axis = 0; axis < 6; ++axis) {
      names.push_back(group == 3 ? kWrench[axis] : std::string(kGroups[group]) + kAxes[axis]);
    }
  }
  names.push_back("gripper");
  names.push_back("gripper_commanded");
  return names;
}

}  // namespace

Observation::Observation(Section& task, const TaskSpec& spec)
    : X_W_origin_(spec.X_W_origin), X_HO_(spec.X_HO), object_is_free_(spec.grasp_width > 0.0) {
  names_ = task.texts("observation");
  if (names_.empty() || names_.size() > kMaxObservation) {
    throw ScenarioError(task.place("observation") + " has " + std::to_string(names_.size()) +
                        " names; it must have 1 to " + std::to_string(kMaxObservation) + ".");
  }
  const std::vector<std::string> known = all_terms();
  for (const std::string& name : names_) {
    const auto found = std::find(known.begin(), known.end(), name);
    if (found == known.end()) {
      throw ScenarioError(task.place("observation") + " names '" + name +
                          "', which is unknown. Did you mean '" + nearest_name(name, known) + "'?");
    }
    terms_.push_back(static_cast<int>(found - known.begin()));
  }
  Section noise = task.section("observation_noise");
  bias_m_ = noise.number("goal_bias_m", 0.0, 0.05);
  bias_rad_ = noise.number("goal_bias_rad", 0.0, 0.5);
  jitter_m_ = noise.number("goal_jitter_m", 0.0, 0.05);
  jitter_rad_ = noise.number("goal_jitter_rad", 0.0, 0.5);
  noise.finish();
  fine_m_ = task.number("fine_range_m", 1e-4, 1.0);
  fine_rad_ = task.number("fine_range_rad", 1e-3, 3.2);
}

void Observation::hide_truth() {
  const auto is_truth = [](const std::string& name) {
    return name.rfind("goal_", 0) == 0 || name.rfind("object_", 0) == 0;
  };
  std::vector<std::string> names;
  std::vector<int> terms;
  for (size_t i = 0; i < names_.size(); ++i) {
    if (is_truth(names_[i])) continue;
    names.push_back(names_[i]);
    terms.push_back(terms_[i]);
  }
  names_ = names;
  terms_ = terms;
}

void Observation::write(const StepSnapshot& s, float* out) const noexcept {
  // An estimate: one bias for the episode, one jitter for the step; the goal's are drawn first.
  Random bias = random_for(s.episode_seed, Purpose::observation, ~0ull);
  Random jitter = random_for(s.episode_seed, Purpose::observation, static_cast<uint64_t>(s.step));
  const auto estimate = [&](const Pose& truth) {
    Twist error;
    for (int i = 0; i < 3; ++i) error[i] = bias.normal(bias_m_) + jitter.normal(jitter_m_);
    for (int i = 3; i < 6; ++i) error[i] = bias.normal(bias_rad_) + jitter.normal(jitter_rad_);
    return add(truth, error);
  };
  const Pose X_WG = estimate(s.truth.X_WG);
  const Pose X_WO = object_is_free_ ? estimate(s.truth.X_WO) : s.X_WE * X_HO_;

  // The goal's z points out of it, the object's z into it: compare after turning the goal about its
  // x axis.
  const Pose turned{X_WG.p, X_WG.R * Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0)};
  const Twist goal = minus(turned, X_WO), object = minus(X_WO * inverse(X_HO_), s.X_WE);

  double table[6 * kGroupCount + 2];
  Eigen::Map<Twist>(table + 0) = minus(s.X_WE, X_W_origin_);
  Eigen::Map<Twist>(table + 6) = s.V_WE;
  Eigen::Map<Twist>(table + 12) = minus(s.X_WE_commanded, s.X_WE);
  Eigen::Map<Wrench>(table + 18) = s.F_ext_W;
  Eigen::Map<Twist>(table + 24) = goal;
  Eigen::Map<Twist>(table + 36) = object;
  for (int i = 0; i < 6; ++i) {
    const double range = i < 3 ? fine_m_ : fine_rad_;
    table[30 + i] = std::clamp(goal[i] / range, -1.0, 1.0);
    table[42 + i] = std::clamp(object[i] / range, -1.0, 1.0);
  }
  table[48] = s.gripper_width;
  table[49] = s.gripper_commanded;
  for (int i = 0; i < size(); ++i) out[i] = static_cast<float>(table[terms_[i]]);
}

}  // namespace tandem
