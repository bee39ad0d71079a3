#pragma once

#include "controller/task/reset.h"
#include "controller/task/task.h"

namespace tandem {

/// A square nut lies on the table; pick it by its handle, lower it over a square peg, let go.
///
/// The nut fits at four yaws: the goal is the one nearest to how it lies. Success: the nut is
/// around the peg and down, the fingers are off it and the hand is away. Serves `square` and
/// `square-robosuite`, which differ in scene and numbers.
class SquareTask final : public Task {
 public:
  explicit SquareTask(Section& section);

  void attach(Simulation& simulation) override;
  void reset(MujocoRobot& robot, ArmModel& arm, uint64_t episode_seed) override;
  SceneTruth truth(const Simulation& simulation) const noexcept override;
  bool succeeded(const SceneTruth& truth, const Simulation& simulation) noexcept override;

 private:
  Pose X_WB_nominal_, X_WG_nominal_;  // nut and peg when nothing is random
  Spread nut_, peg_, start_;
  double lateral_m_, height_m_, hand_away_m_;  // of success
  int nut_body_ = -1, peg_body_ = -1, object_site_ = -1, goal_site_ = -1, grasp_site_ = -1;
  Eigen::Quaterniond quarter_turns_ = Eigen::Quaterniond::Identity();  // from the peg to the goal
};

}  // namespace tandem
