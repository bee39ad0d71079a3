#include "controller/law/arm_model.h"

#include <urdf_parser/urdf_parser.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <kdl_parser/kdl_parser.hpp>
#include <set>
#include <stdexcept>
#include <vector>

namespace tandem {
namespace {

constexpr double kGravity = 9.81;  // m/s^2, as in panda.xml
const char kTool[] = "tool";

KDL::RigidBodyInertia to_kdl(const Load& load) {
  const Eigen::Matrix3d& I = load.inertia_E;
  return KDL::RigidBodyInertia(
      load.mass, KDL::Vector(load.com_E.x(), load.com_E.y(), load.com_E.z()),
      KDL::RotationalInertia(I(0, 0), I(1, 1), I(2, 2), I(0, 1), I(0, 2), I(1, 2)));
}

// Inertia of a branch in its parent's tip frame, everything in it rigid; sliding joints stand at
// `slide`.
KDL::RigidBodyInertia branch_inertia(const KDL::TreeElement& element, double slide) {
  const KDL::Segment& segment = element.segment;
  const bool slides = segment.getJoint().getType() == KDL::Joint::TransAxis;
  KDL::RigidBodyInertia sum = segment.getInertia();
  for (const auto& child : element.children) sum = sum + branch_inertia(child->second, slide);
  return segment.pose(slides ? slide : 0.0) * sum;
}

KDL::Segment with_inertia(const KDL::Segment& s, const KDL::Frame& tip,
                          const KDL::RigidBodyInertia& inertia) {
  return KDL::Segment(s.getName(), s.getJoint(), tip, inertia);
}

// The chain to the tool in seven segments: bodies behind fixed joints and side branches merged with
// the body that carries them.
KDL::Chain merged_chain(const KDL::Tree& tree, const KDL::Chain& path, double slide) {
  std::set<std::string> on_path;
  for (const KDL::Segment& s : path.segments) on_path.insert(s.getName());
  std::vector<KDL::Segment> merged;
  for (const KDL::Segment& s : path.segments) {
    KDL::RigidBodyInertia inertia = s.getInertia();
    for (const auto& child : tree.getSegment(s.getName())->second.children) {
      if (!on_path.count(child->first)) inertia = inertia + branch_inertia(child->second, slide);
    }
    if (s.getJoint().getType() == KDL::Joint::Fixed && !merged.empty()) {
      const KDL::Segment before = merged.back();
      merged.back() = with_inertia(before, before.getFrameToTip() * s.getFrameToTip(),
                                   s.getFrameToTip().Inverse() * before.getInertia() + inertia);
    } else {
      merged.push_back(with_inertia(s, s.getFrameToTip(), inertia));
    }
  }
  KDL::Chain chain;
  for (const KDL::Segment& s : merged) chain.addSegment(s);
  return chain;
}

}  // namespace

ArmModel::ArmModel(const std::string& urdf_path, double gripper_width, double armature)
    : path_(urdf_path), gripper_width_(gripper_width), armature_(armature) {
  if (!std::ifstream(urdf_path))
    throw std::runtime_error(urdf_path + ": the URDF of the arm cannot be opened.");
  const urdf::ModelInterfaceSharedPtr urdf = urdf::parseURDFFile(urdf_path);
  if (!urdf) throw std::runtime_error(urdf_path + ": the file is not a URDF model.");
  KDL::Tree tree;
  KDL::Chain path;
  if (!kdl_parser::treeFromUrdfModel(*urdf, tree) ||
      !tree.getChain(urdf->getRoot()->name, kTool, path)) {
    throw std::runtime_error(urdf_path + ": there is no chain from link `" + urdf->getRoot()->name +
                             "` to link `" + kTool +
                             "`; the tool frame E must be a link of that name.");
  }
  bare_ = merged_chain(tree, path, 0.5 * gripper_width);
  if (bare_.getNrOfJoints() != 7) {
    throw std::runtime_error(urdf_path + ": " + std::to_string(bare_.getNrOfJoints()) +
                             " joints lead to link `" + kTool + "`; the controller is made for 7.");
  }
  int i = 0;
  for (const KDL::Segment& s : bare_.segments) {
    if (s.getJoint().getType() == KDL::Joint::Fixed) continue;
    const urdf::JointConstSharedPtr joint = urdf->getJoint(s.getJoint().getName());
    if (joint->type != urdf::Joint::REVOLUTE || !joint->limits ||
        !(joint->limits->lower < joint->limits->upper)) {
      throw std::runtime_error(urdf_path + ": " + joint->name +
                               " must be revolute with <limit lower upper velocity effort>.");
    }
    lower_[i] = joint->limits->lower;
    upper_[i] = joint->limits->upper;
    velocity_[i] = joint->limits->velocity;
    torque_[i] = joint->limits->effort;
    ++i;
  }
  set_load(Load{});
}

void ArmModel::set_load(const Load& load) {
  const bool finite =
      std::isfinite(load.mass) && load.com_E.allFinite() && load.inertia_E.allFinite();
  if (!finite || load.mass < 0 || !load.inertia_E.isApprox(load.inertia_E.transpose(), 1e-9) ||
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(load.inertia_E).eigenvalues().minCoeff() <
          -1e-12) {
    throw std::invalid_argument("The load in hand (" + std::to_string(load.mass) +
                                " kg) is not a rigid body: mass must be >= 0 kg and its inertia "
                                "symmetric, finite and >= 0.");
  }
  load_ = load;
  chain_ = KDL::Chain();
  for (unsigned int i = 0; i < bare_.getNrOfSegments(); ++i) {
    const KDL::Segment& s = bare_.getSegment(i);
    const bool last = i + 1 == bare_.getNrOfSegments();
    chain_.addSegment(last ? with_inertia(s, s.getFrameToTip(), s.getInertia() + to_kdl(load)) : s);
  }
  dynamics_ = std::make_unique<KDL::ChainDynParam>(chain_, KDL::Vector(0, 0, -kGravity));
}

void ArmModel::update(const JointVector& q, const JointVector& dq, ArmState& state) noexcept {
  state.q = q;
  state.dq = dq;
  kinematics(q, state.X_WE, state.J);
  state.V_WE.noalias() = state.J * dq;
  q_.data = q;
  dq_.data = dq;
  dynamics_->JntToCoriolis(q_, dq_, torque_out_);
  state.coriolis = torque_out_.data;
}

JointMatrix ArmModel::mass(const JointVector& q) noexcept {
  q_.data = q;
  dynamics_->JntToMass(q_, mass_out_);
  JointMatrix M = mass_out_.data;
  M.diagonal().array() += armature_;
  return M;
}

JointVector ArmModel::gravity(const JointVector& q) noexcept {
  q_.data = q;
  dynamics_->JntToGravity(q_, torque_out_);
  return torque_out_.data;
}

// One pass for pose and Jacobian: KDL has a solver for each, which would walk the chain twice.
void ArmModel::kinematics(const JointVector& q, Pose& X_WE, Jacobian& J) const noexcept {
  KDL::Frame tip;
  KDL::Vector axis[7], origin[7];
  int i = 0;
  for (const KDL::Segment& segment : chain_.segments) {
    const KDL::Joint& joint = segment.getJoint();
    if (joint.getType() == KDL::Joint::Fixed) {
      tip = tip * segment.pose(0.0);
      continue;
    }
    axis[i] = tip.M * joint.JointAxis();
    origin[i] = tip * joint.JointOrigin();
    tip = tip * segment.pose(q[i]);
    ++i;
  }
  for (i = 0; i < 7; ++i) {
    const KDL::Vector v = axis[i] * (tip.p - origin[i]);
    J.col(i) << v.x(), v.y(), v.z(), axis[i].x(), axis[i].y(), axis[i].z();
  }
  X_WE.p = Eigen::Vector3d(tip.p.x(), tip.p.y(), tip.p.z());
  X_WE.R = Eigen::Quaterniond(
      Eigen::Matrix3d(Eigen::Matrix<double, 3, 3, Eigen::RowMajor>::Map(tip.M.data)));
  if (X_WE.R.w() < 0) X_WE.R.coeffs() *= -1;
}

// Damped Newton steps; a joint at its limit that would leave it sits out the step.
JointVector ArmModel::solve_ik(const Pose& X_WE, const JointVector& seed) {
  constexpr int kIterations = 200;
  constexpr double kTolerance = 1e-10, kDamping = 1e-4, kLargestStep = 0.2;
  JointVector q = seed.cwiseMax(lower_).cwiseMin(upper_);
  Pose X;
  Jacobian J;
  Twist error = Twist::Zero();
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    kinematics(q, X, J);
    error = minus(X_WE, X);
    if (error.norm() < kTolerance) return q;
    JointVector step = JointVector::Zero();
    for (int attempt = 0; attempt < 7; ++attempt) {
      const Twist dual =
          (J * J.transpose() + kDamping * kDamping * Eigen::Matrix<double, 6, 6>::Identity())
              .ldlt()
              .solve(error);
      step = J.transpose() * dual;
      bool blocked = false;
      for (int i = 0; i < 7; ++i) {
        if ((q[i] <= lower_[i] && step[i] < 0) || (q[i] >= upper_[i] && step[i] > 0))
          J.col(i).setZero(), blocked = true;
      }
      if (!blocked) break;
    }
    const double largest = step.cwiseAbs().maxCoeff();
    if (largest > kLargestStep) step *= kLargestStep / largest;
    q = (q + step).cwiseMax(lower_).cwiseMin(upper_);
  }
  char text[400];
  std::snprintf(
      text, sizeof text,
      "No joint angles within the limits of %s bring the tool to p = (%.4f, %.4f, %.4f) m: %.2f mm "
      "and %.2f mrad remain. "
      "Choose a pose in reach (about 0.85 m around the shoulder at 0.333 m) or another seed.",
      path_.c_str(), X_WE.p.x(), X_WE.p.y(), X_WE.p.z(), 1e3 * error.head<3>().norm(),
      1e3 * error.tail<3>().norm());
  throw std::runtime_error(text);
}

}  // namespace tandem
