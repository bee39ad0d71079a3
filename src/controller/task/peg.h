#pragma once

#include "controller/task/reset.h"
#include "controller/task/task.h"

namespace tandem {

/// Square peg in the gripper, square hole in a block that stands elsewhere at every reset.
///
/// Hidden from the policy: the in-hand error and the bias of the hole's estimate. Success: the tip
/// is `success_depth_m` below the rim, inside the hole.
class PegTask final : public Task {
 public:
  explicit PegTask(Section& section);

  void attach(Simulation& simulation) override;
  void reset(MujocoRobot& robot, ArmModel& arm, uint64_t episode_seed) override;
  SceneTruth truth(const Simulation& simulation) const noexcept override;
  bool succeeded(const SceneTruth& truth, const Simulation& simulation) noexcept override;

 private:
  double clearance_m_, success_depth_m_, gripper_width_m_, tilt_rad_;
  Pose X_WG_nominal_;  // the hole when nothing is random
  Spread hole_, start_, in_hand_;
  int peg_body_ = -1, hole_body_ = -1, tip_site_ = -1, rim_site_ = -1;
};

}  // namespace tandem
