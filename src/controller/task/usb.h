#pragma once

#include "controller/task/reset.h"
#include "controller/task/task.h"

namespace tandem {

/// A USB-A plug stands in a stand; bring it to one port of a motherboard's rear panel and press it
/// in.
///
/// Which port, where the panel and where the stand are is drawn at each reset; so are two LED
/// lights, which are only looks. Success: the shell is `depth_m` below the panel's face,
/// `lateral_m` from the port's axis, for `hold_steps` policy steps in a row; the hand may hold on.
class UsbTask final : public Task {
 public:
  explicit UsbTask(Section& section);

  void attach(Simulation& simulation) override;
  void stage(Simulation& simulation, uint64_t episode_seed) const override;
  void reset(MujocoRobot& robot, ArmModel& arm, uint64_t episode_seed) override;
  SceneTruth truth(const Simulation& simulation) const noexcept override;
  bool succeeded(const SceneTruth& truth, const Simulation& simulation) noexcept override;

 private:
  struct Port {
    std::string name;
    int body = -1;  // what closes it when it is not the one that is wanted
    Pose X_PG;      // in the panel's frame
  };

  Pose X_WP_nominal_, X_WS_nominal_;  // panel and stand when nothing is random
  Spread panel_, stand_, start_;
  std::vector<Port> ports_;  // in use
  double depth_m_, lateral_m_;
  int hold_steps_, held_steps_ = 0;
  int plug_body_ = -1, panel_body_ = -1, port_body_ = -1, stand_body_ = -1;
  int object_site_ = -1, goal_site_ = -1, seat_site_ = -1;
};

}  // namespace tandem
