#pragma once

#include <kdl/chain.hpp>
#include <kdl/chaindynparam.hpp>
#include <memory>
#include <string>

#include "base/geometry.h"
#include "controller/robot/robot.h"

namespace tandem {

/// The arm at one instant, as the law sees it. Filled by ArmModel::update().
struct ArmState {
  JointVector q = JointVector::Zero();         ///< rad
  JointVector dq = JointVector::Zero();        ///< rad/s
  Pose X_WE;                                   ///< tool in base, w >= 0
  Jacobian J = Jacobian::Zero();               ///< V_WE = J dq
  Twist V_WE = Twist::Zero();                  ///< m/s, rad/s; base axes
  JointVector coriolis = JointVector::Zero();  ///< N m, C(q, dq) dq; gravity excluded
};

/// Rigid-body model of arm, hand and load: a URDF computed by KDL.
///
/// The chain runs from the URDF's root to link `tool` (= E). Links behind fixed joints are merged
/// with their parents, and side branches (the fingers) count as rigid at `gripper_width`. Rotor
/// inertia, which URDF cannot say, is added to the mass matrix.
///
/// Real-time: update(), mass() and gravity() do not allocate and are noexcept. One thread a model:
/// it holds the solvers' workspace.
class ArmModel {
 public:
  /// `gripper_width` m, at which the fingers' inertia is taken; `armature` kg m^2 a joint.
  /// @throws std::runtime_error with a sentence if the file is not a URDF with seven revolute
  /// joints up to `tool`.
  explicit ArmModel(const std::string& urdf_path, double gripper_width = 0.02,
                    double armature = 0.1);

  /// The object in hand, in place of the one before. Not real-time. @throws std::invalid_argument
  /// if it is not physical.
  void set_load(const Load& load);
  const Load& load() const { return load_; }

  /// Pose, Jacobian, twist and Coriolis torque at (q, dq).
  void update(const JointVector& q, const JointVector& dq, ArmState& state) noexcept;

  /// Mass matrix M(q), kg m^2, rotor inertia included.
  JointMatrix mass(const JointVector& q) noexcept;

  /// Torque that holds the arm against gravity at q, N m.
  JointVector gravity(const JointVector& q) noexcept;

  /// Joints that bring E to X_WE, near `seed`: within limits, least motion from the seed. Not
  /// real-time, deterministic.
  /// @throws std::runtime_error with a sentence if there is none in reach, with the error that
  /// remains.
  JointVector solve_ik(const Pose& X_WE, const JointVector& seed);

  /// m, at which the fingers' inertia was taken.
  double gripper_width() const { return gripper_width_; }
  const JointVector& lower_limit() const { return lower_; }        ///< rad
  const JointVector& upper_limit() const { return upper_; }        ///< rad
  const JointVector& velocity_limit() const { return velocity_; }  ///< rad/s
  const JointVector& torque_limit() const { return torque_; }      ///< N m

 private:
  void kinematics(const JointVector& q, Pose& X_WE, Jacobian& J) const noexcept;

  std::string path_;
  double gripper_width_;
  double armature_;
  Load load_;
  KDL::Chain bare_;   // seven segments; the last one's tip is E
  KDL::Chain chain_;  // with the load
  std::unique_ptr<KDL::ChainDynParam> dynamics_;
  KDL::JntArray q_{7}, dq_{7}, torque_out_{7};
  KDL::JntSpaceInertiaMatrix mass_out_{7};
  JointVector lower_, upper_, velocity_, torque_;
};

}  // namespace tandem
