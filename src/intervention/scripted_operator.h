#pragma once

#include <deque>
#include <tandem/teleop_command_t.hpp>
#include <tandem/world_state_t.hpp>

#include "base/geometry.h"
#include "base/section.h"

namespace tandem {

/// The rules of config/operator.yaml; units and reasons stand there.
struct OperatorRules {
  std::string name;
  double speed_low, speed_high, gain, see_bias_m, see_bias_rad;
  int see_delay_steps;
  double tremor, tremor_memory, pause_probability;
  int pause_steps;
  double hover_m, clear_low_m, clear_high_m, align_m, align_rad, touch_m, touch_force, push_force,
      wiggle_m;
  int wiggle_after_steps;
  double reach_hover_m, reach_align_m, reach_align_rad, reach_down_m, grip_m, slip_m, slip_rad;
  int reaction_steps_low, reaction_steps_high, no_progress_steps;
  double patience_gain, progress_m, away_m, low_m, beside_m, askew_rad, force, held_force;
  int force_steps, hurry_steps, give_up_steps;
  int hold_steps;
  double recovered_share, seated_m, near_m;
};

/// @throws ScenarioError
OperatorRules read_rules(Section section);

/// A person's stand-in on the teleop channel: demonstrates, watches, takes over, lets go; by
/// published rules.
///
/// He sees the truth of the simulator as a person sees the scene: late, with a misjudgement that
/// stays for an episode, and acts with tremor and pauses. Everything random comes from the
/// episode's seed, so the same WORLD_STATEs give the same answers; a repeated WORLD_STATE gets the
/// same answer again.
class ScriptedOperator {
 public:
  explicit ScriptedOperator(const OperatorRules& rules) : rules_(rules) {}

  teleop_command_t answer(const world_state_t& world);

 private:
  /// What he does next: brings the hand to an object that lies about, brings the object to its
  /// goal, leaves it there, or puts back what has slipped in the hand to take it anew.
  enum class Leg { reach, place, leave, put_back };

  /// What moves (object, or hand on its way to one), seen from where it should go (goal, or grasp).
  struct View {
    Leg leg;
    Eigen::Vector3d tip;  ///< m, in the target's axes, z = height above it
    double yaw;           ///< rad, turn that would align it
    Pose X_WE;
    Eigen::Matrix3d R_WT;  ///< target's axes
    double tilt;           ///< rad, of the object against the goal
    double distance;       ///< m, still to go, over all legs
    double carry;          ///< m, the last leg's share of it
    double force;          ///< N
    double gripper_width;  ///< m
  };

  void begin_episode(const world_state_t& world);
  View look(const world_state_t& world) const;
  /// What he has asked for since, and still expects to happen, added to what he saw.
  View expect(const world_state_t& world, View seen) const;
  bool wants_authority(const world_state_t& world, const View& now);
  bool has_reason(const world_state_t& world, const View& now);
  /// Whether the object has toppled, or he has long got no nearer himself: lost, jammed or out of
  /// his reach.
  bool gives_up(const View& now);
  bool lets_go(const world_state_t& world, const View& now) const;
  /// What his fingers ask for, [-1, 1]: -1 open, 1 closed.
  double grip(const world_state_t& world, const View& seen);
  Twist move(const world_state_t& world, const View& seen);
  /// Where the tip should go, from where it is, m, target's axes.
  Eigen::Vector3d heading(const world_state_t& world, const View& seen);

  OperatorRules rules_;
  teleop_command_t last_{};

  int64_t episode_ = -1;
  double speed_ = 1.0;
  Eigen::Vector3d see_bias_ = Eigen::Vector3d::Zero();
  double see_bias_yaw_ = 0.0;
  Pose X_WH_start_;  // the grasp when the episode began
  int reaction_steps_ = 0;
  double clear_ = 0.0;  // m

  std::deque<View> views_;
  Twist tremor_ = Twist::Zero();
  int pause_left_ = 0, stuck_steps_ = 0;
  double lowest_ = 0.0;
  bool aligned_ = false, closing_ = false, dropping_ = false, putting_back_ = false;

  bool engaged_ = false;
  int reason_steps_ = 0, held_steps_ = 0, since_best_ = 0, force_steps_ = 0;
  double best_distance_ = 0.0, distance_at_takeover_ = 0.0;
  double own_best_distance_ = 0.0;  // since he has the arm
  int since_own_best_ = 0;
};

}  // namespace tandem
