#pragma once

#include <mujoco/mujoco.h>

#include <memory>
#include <string>

#include "base/geometry.h"
#include "controller/robot/robot.h"

namespace tandem {

/// A MuJoCo scene with one arm in it: owns model and data, and speaks of bodies and sites by name.
///
/// The MuJoCo world is W, the robot's base frame. The scene must hold what models/panda/panda.xml
/// defines: joints joint1..7, finger_left and finger_right, body `hand`, site `tool` (= E).
///
/// Between two calls everything that depends on positions and velocities (poses, contacts, inertia)
/// belongs to the present state: step() integrates first and computes kinematics after. Only forces
/// are of the step that has just passed.
///
/// Real-time: what is noexcept neither allocates nor logs. Names are looked up once, at
/// construction of the user.
class Simulation {
 public:
  static constexpr double kTimeStep = 0.001;  ///< s

  /// `files` stand in for files on disk of the same name (the renderer gives the arm its covers
  /// that way).
  /// @throws std::runtime_error with a sentence if the scene cannot be read, is not at 1 kHz or
  /// lacks a part of the arm.
  explicit Simulation(const std::string& scene_path, const mjVFS* files = nullptr);

  /// One step of 1 ms. `tau` N m on the arm's joints and `finger_force` N on left and right finger
  /// (+ opens), gravity of arm, hand and whatever is fixed to the hand excluded: it is compensated
  /// exactly, as the real robot does.
  void step(const JointVector& tau, const Eigen::Vector2d& finger_force) noexcept;

  /// Puts the arm at q and the fingers `gripper_width` (m) apart, every other joint where the scene
  /// has it, all of it at rest, and forgets the forces of the last step.
  void set_arm(const JointVector& q, double gripper_width) noexcept;

  JointVector q() const noexcept { return JointVector::Map(data_->qpos + arm_q_); }
  JointVector dq() const noexcept { return JointVector::Map(data_->qvel + arm_v_); }
  Eigen::Vector2d finger_position() const noexcept {
    return {data_->qpos[finger_q_[0]], data_->qpos[finger_q_[1]]};
  }
  Eigen::Vector2d finger_velocity() const noexcept {
    return {data_->qvel[finger_v_[0]], data_->qvel[finger_v_[1]]};
  }

  /// Torque of contacts, joint stops and pushes on the arm's joints during the last step, N m; +
  /// pushes the joint forward.
  JointVector external_torque() const noexcept { return external_torque_; }

  /// Force and moment about E of all contacts of hand, fingers and held object with anything else
  /// during the last step; W axes, + = environment pushes the arm. A push is a contact, too.
  const Wrench& contact_wrench() const noexcept { return contact_wrench_; }

  /// Somebody pushes the hand from the next step on, until this is called with zero: force and
  /// moment about E, W axes. To write `hand`'s xfrc_applied does the same.
  void push(const Wrench& F_W) noexcept;

  /// Numbers of named parts. @throws std::runtime_error with a sentence and the names there are.
  int body(const std::string& name) const;
  int site(const std::string& name) const;
  int geom(const std::string& name) const;

  Pose body_pose(int body) const noexcept;                           ///< X_WB
  Pose site_pose(int site) const noexcept;                           ///< X_WS
  Pose tool_pose() const noexcept { return site_pose(tool_site_); }  ///< X_WE
  Twist tool_velocity() const noexcept;                              ///< V_WE

  /// Moves a body that has no joint: X_PB, its pose in its parent's frame (for fixtures W, for the
  /// held object `hand`). Poses and contacts follow at the next forward() or set_arm().
  void place_body(int body, const Pose& X_PB) noexcept;
  Pose placed_body(int body) const noexcept;  ///< X_PB

  /// Puts a body with a free joint at X_WB, at rest. Poses and contacts follow at the next
  /// forward(); set_arm() takes it back to where the scene has it.
  void place_free_body(int body, const Pose& X_WB) noexcept;
  bool is_free(int body) const noexcept;  ///< has a free joint
  bool is_on_hand(int body) const noexcept {
    return on_hand_[body];
  }  ///< hand, finger or fixed to it

  /// Moves the body of a site so that the site is at X_WS: a free body, or one without a joint.
  void place_site(int site, const Pose& X_WS) noexcept;

  /// Pose of E in the frame of `hand`: place the held object at hand_to_tool() * X_EO.
  Pose hand_to_tool() const noexcept;

  /// Recomputes everything that depends on the state, after the state or the scene was rewritten.
  void forward() noexcept;

  /// Mass, centre and inertia of all that is fixed to the hand beside hand and fingers, for
  /// ArmModel::set_load().
  Load held_load() const;

  double time() const noexcept { return data_->time; }  ///< s since construction
  double lower_limit(int joint) const noexcept { return limits_(joint, 0); }  ///< rad, joint 0..6
  double upper_limit(int joint) const noexcept { return limits_(joint, 1); }  ///< rad
  const std::string& path() const noexcept { return path_; }
  mjModel* model() noexcept { return model_.get(); }
  const mjModel* model() const noexcept { return model_.get(); }
  mjData* data() noexcept { return data_.get(); }
  const mjData* data() const noexcept { return data_.get(); }
  /// Address of joint1 in qpos and in qvel; the other six follow.
  int arm_qpos() const noexcept { return arm_q_; }
  int arm_dof() const noexcept { return arm_v_; }
  int finger_qpos(int finger) const noexcept { return finger_q_[finger]; }  ///< 0 left, 1 right

 private:
  struct FreeModel {
    void operator()(mjModel* model) const { mj_deleteModel(model); }
  };
  struct FreeData {
    void operator()(mjData* data) const { mj_deleteData(data); }
  };

  int find(int type, const char* kind, const std::string& name) const;
  void compensate_gravity() noexcept;
  void measure_contacts() noexcept;
  void measure_push() noexcept;

  std::string path_;
  std::unique_ptr<mjModel, FreeModel> model_;
  std::unique_ptr<mjData, FreeData> data_;
  int arm_q_ = 0, arm_v_ = 0;
  int arm_joint_[7] = {};
  int finger_q_[2] = {}, finger_v_[2] = {}, finger_joint_[2] = {};
  int hand_body_ = 0, tool_site_ = 0;
  Eigen::Matrix<double, 7, 2> limits_;
  JointVector external_torque_ = JointVector::Zero();
  Wrench contact_wrench_ = Wrench::Zero();
  std::unique_ptr<bool[]> on_hand_;  ///< per body: hand, finger or held object
};

}  // namespace tandem
