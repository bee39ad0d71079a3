#include "controller/robot/simulation.h"

#include <cmath>
#include <stdexcept>

namespace tandem {
namespace {

Pose from_mujoco(const mjtNum* p, const mjtNum* q) {
  Pose X;
  X.p = Eigen::Vector3d::Map(p);
  X.R = Eigen::Quaterniond(q[0], q[1], q[2], q[3]);
  if (X.R.w() < 0) X.R.coeffs() *= -1;
  return X;
}

Eigen::Matrix3d matrix(const mjtNum* row_major) {
  return Eigen::Matrix<double, 3, 3, Eigen::RowMajor>::Map(row_major);
}

Pose from_mujoco_matrix(const mjtNum* p, const mjtNum* row_major) {
  mjtNum q[4];
  mju_mat2Quat(q, row_major);
  return from_mujoco(p, q);
}

// MuJoCo's default is a message on stderr and a file in the working directory, once a warning, from
// within the loop.
void ignore_warning(const char*) {}

}  // namespace

Simulation::Simulation(const std::string& scene_path, const mjVFS* files) : path_(scene_path) {
  mju_user_warning = ignore_warning;
  char reason[1000] = "";
  model_.reset(mj_loadXML(scene_path.c_str(), files, reason, sizeof reason));
  if (!model_) throw std::runtime_error(scene_path + ": MuJoCo cannot load the scene: " + reason);
  if (std::abs(model_->opt.timestep - kTimeStep) > 1e-12) {
    throw std::runtime_error(scene_path + ": the time step is " +
                             std::to_string(model_->opt.timestep) +
                             " s; the robot's cycle is 0.001 s. Set <option timestep=\"0.001\"/>.");
  }
  data_.reset(mj_makeData(model_.get()));
  if (!data_)
    throw std::runtime_error(scene_path + ": MuJoCo cannot allocate the simulation's data.");

  for (int i = 0; i < 7; ++i) {
    arm_joint_[i] = find(mjOBJ_JOINT, "joint", "joint" + std::to_string(i + 1));
    const int q = model_->jnt_qposadr[arm_joint_[i]];
    const int v = model_->jnt_dofadr[arm_joint_[i]];
    if (i == 0) arm_q_ = q, arm_v_ = v;
    if (q != arm_q_ + i || v != arm_v_ + i) {
      throw std::runtime_error(scene_path + ": joint" + std::to_string(i + 1) +
                               " does not follow the joint before it; joints 1 to 7 must be one "
                               "chain, as in panda.xml.");
    }
    limits_(i, 0) = model_->jnt_range[2 * arm_joint_[i]];
    limits_(i, 1) = model_->jnt_range[2 * arm_joint_[i] + 1];
  }
  const char* fingers[2] = {"finger_left", "finger_right"};
  for (int i = 0; i < 2; ++i) {
    finger_joint_[i] = find(mjOBJ_JOINT, "joint", fingers[i]);
    finger_q_[i] = model_->jnt_qposadr[finger_joint_[i]];
    finger_v_[i] = model_->jnt_dofadr[finger_joint_[i]];
  }
  hand_body_ = body("hand");
  tool_site_ = site("tool");
  if (model_->site_bodyid[tool_site_] != hand_body_) {
    throw std::runtime_error(
        scene_path +
        ": site `tool` is not on body `hand`; E must be fixed to the hand, as in panda.xml.");
  }
  on_hand_ = std::make_unique<bool[]>(model_->nbody);
  for (int b = 0; b < model_->nbody; ++b)
    on_hand_[b] = b == hand_body_ || (b > 0 && on_hand_[model_->body_parentid[b]]);
  forward();
}

void Simulation::step(const JointVector& tau, const Eigen::Vector2d& finger_force) noexcept {
  JointVector::Map(data_->qfrc_applied + arm_v_) = tau;
  for (int i = 0; i < 2; ++i) data_->qfrc_applied[finger_v_[i]] = finger_force[i];
  compensate_gravity();
  mj_step2(model_.get(), data_.get());
  external_torque_ = JointVector::Map(data_->qfrc_constraint + arm_v_);
  measure_contacts();
  measure_push();
  mj_step1(model_.get(), data_.get());
}

// A joint carries the weight of the subtree behind it: m_subtree g at that subtree's centre of
// mass.
void Simulation::compensate_gravity() noexcept {
  const Eigen::Vector3d g = Eigen::Vector3d::Map(model_->opt.gravity);
  const auto weight = [&](int joint) -> Eigen::Vector3d {
    return g * model_->body_subtreemass[model_->jnt_bodyid[joint]];
  };
  for (int i = 0; i < 7; ++i) {
    const int joint = arm_joint_[i];
    const Eigen::Vector3d arm =
        Eigen::Vector3d::Map(data_->subtree_com + 3 * model_->jnt_bodyid[joint]) -
        Eigen::Vector3d::Map(data_->xanchor + 3 * joint);
    data_->qfrc_applied[arm_v_ + i] -=
        Eigen::Vector3d::Map(data_->xaxis + 3 * joint).dot(arm.cross(weight(joint)));
  }
  for (int i = 0; i < 2; ++i) {
    data_->qfrc_applied[finger_v_[i]] -=
        Eigen::Vector3d::Map(data_->xaxis + 3 * finger_joint_[i]).dot(weight(finger_joint_[i]));
  }
}

void Simulation::measure_contacts() noexcept {
  contact_wrench_.setZero();
  const Eigen::Vector3d p_WE = Eigen::Vector3d::Map(data_->site_xpos + 3 * tool_site_);
  for (int i = 0; i < data_->ncon; ++i) {
    const mjContact& contact = data_->contact[i];
    const bool first = on_hand_[model_->geom_bodyid[contact.geom1]];
    const bool second = on_hand_[model_->geom_bodyid[contact.geom2]];
    if (first == second) continue;
    mjtNum force[6];  // on geom2, in the contact's frame, whose axes are the rows of contact.frame
    mj_contactForce(model_.get(), data_.get(), i, force);
    const Eigen::Matrix3d axes = matrix(contact.frame);
    const double sign = second ? 1.0 : -1.0;
    const Eigen::Vector3d f = sign * (axes.transpose() * Eigen::Vector3d::Map(force));
    const Eigen::Vector3d m = sign * (axes.transpose() * Eigen::Vector3d::Map(force + 3));
    contact_wrench_.head<3>() += f;
    contact_wrench_.tail<3>() += m + (Eigen::Vector3d::Map(contact.pos) - p_WE).cross(f);
  }
}

// xfrc_applied acts at the hand's centre of mass.
void Simulation::push(const Wrench& F_W) noexcept {
  const Eigen::Vector3d p_WE = Eigen::Vector3d::Map(data_->site_xpos + 3 * tool_site_);
  const Eigen::Vector3d p_WC = Eigen::Vector3d::Map(data_->xipos + 3 * hand_body_);
  mjtNum* applied = data_->xfrc_applied + 6 * hand_body_;
  Eigen::Vector3d::Map(applied) = F_W.head<3>();
  Eigen::Vector3d::Map(applied + 3) = F_W.tail<3>() + (p_WE - p_WC).cross(F_W.head<3>());
}

void Simulation::measure_push() noexcept {
  const Wrench push = Wrench::Map(data_->xfrc_applied + 6 * hand_body_);
  if (push.isZero(0.0)) return;
  const Eigen::Vector3d f = push.head<3>(), m = push.tail<3>();
  const Eigen::Vector3d p_WC = Eigen::Vector3d::Map(data_->xipos + 3 * hand_body_);
  for (int i = 0; i < 7; ++i) {
    const int joint = arm_joint_[i];
    const Eigen::Vector3d arm = p_WC - Eigen::Vector3d::Map(data_->xanchor + 3 * joint);
    external_torque_[i] += Eigen::Vector3d::Map(data_->xaxis + 3 * joint).dot(m + arm.cross(f));
  }
  const Eigen::Vector3d p_WE = Eigen::Vector3d::Map(data_->site_xpos + 3 * tool_site_);
  contact_wrench_.head<3>() += f;
  contact_wrench_.tail<3>() += m + (p_WC - p_WE).cross(f);
}

void Simulation::set_arm(const JointVector& q, double gripper_width) noexcept {
  mju_copy(data_->qpos, model_->qpos0, model_->nq);
  mju_zero(data_->qvel, model_->nv);
  JointVector::Map(data_->qpos + arm_q_) = q;
  for (int i = 0; i < 2; ++i) data_->qpos[finger_q_[i]] = 0.5 * gripper_width;
  mju_zero(data_->qfrc_applied, model_->nv);
  mju_zero(data_->qacc_warmstart, model_->nv);
  external_torque_.setZero();
  contact_wrench_.setZero();
  forward();
}

void Simulation::forward() noexcept { mj_step1(model_.get(), data_.get()); }

Pose Simulation::body_pose(int body) const noexcept {
  return from_mujoco(data_->xpos + 3 * body, data_->xquat + 4 * body);
}

Pose Simulation::site_pose(int site) const noexcept {
  return from_mujoco_matrix(data_->site_xpos + 3 * site, data_->site_xmat + 9 * site);
}

Twist Simulation::tool_velocity() const noexcept {
  mjtNum v[6];  // angular first, axes of the world
  mj_objectVelocity(model_.get(), data_.get(), mjOBJ_SITE, tool_site_, v, 0);
  Twist V;
  V << v[3], v[4], v[5], v[0], v[1], v[2];
  return V;
}

void Simulation::place_body(int body, const Pose& X_PB) noexcept {
  Eigen::Vector3d::Map(model_->body_pos + 3 * body) = X_PB.p;
  mjtNum* q = model_->body_quat + 4 * body;
  q[0] = X_PB.R.w(), q[1] = X_PB.R.x(), q[2] = X_PB.R.y(), q[3] = X_PB.R.z();
}

Pose Simulation::placed_body(int body) const noexcept {
  return from_mujoco(model_->body_pos + 3 * body, model_->body_quat + 4 * body);
}

bool Simulation::is_free(int body) const noexcept {
  return model_->body_jntnum[body] == 1 &&
         model_->jnt_type[model_->body_jntadr[body]] == mjJNT_FREE;
}

void Simulation::place_free_body(int body, const Pose& X_WB) noexcept {
  const int joint = model_->body_jntadr[body];
  mjtNum* q = data_->qpos + model_->jnt_qposadr[joint];
  Eigen::Vector3d::Map(q) = X_WB.p;
  q[3] = X_WB.R.w(), q[4] = X_WB.R.x(), q[5] = X_WB.R.y(), q[6] = X_WB.R.z();
  mju_zero(data_->qvel + model_->jnt_dofadr[joint], 6);
}

void Simulation::place_site(int site, const Pose& X_WS) noexcept {
  const int body = model_->site_bodyid[site];
  const Pose X_BS = from_mujoco(model_->site_pos + 3 * site, model_->site_quat + 4 * site);
  const Pose X_WB = X_WS * inverse(X_BS);
  if (is_free(body)) {
    place_free_body(body, X_WB);
  } else {
    place_body(body, inverse(body_pose(model_->body_parentid[body])) * X_WB);
  }
}

Pose Simulation::hand_to_tool() const noexcept {
  return from_mujoco(model_->site_pos + 3 * tool_site_, model_->site_quat + 4 * tool_site_);
}

Load Simulation::held_load() const {
  Load load;
  const int left = model_->jnt_bodyid[finger_joint_[0]];
  const int right = model_->jnt_bodyid[finger_joint_[1]];
  const Pose X_EW = inverse(tool_pose());
  const auto held = [&](int b) {
    return on_hand_[b] && b != hand_body_ && b != left && b != right;
  };
  const auto com_E = [&](int b) -> Eigen::Vector3d {
    return X_EW.p + X_EW.R * Eigen::Vector3d::Map(data_->xipos + 3 * b);
  };
  for (int b = 0; b < model_->nbody; ++b) {
    if (!held(b)) continue;
    load.mass += model_->body_mass[b];
    load.com_E += model_->body_mass[b] * com_E(b);
  }
  if (load.mass == 0) return load;
  load.com_E /= load.mass;
  for (int b = 0; b < model_->nbody; ++b) {
    if (!held(b)) continue;
    const Eigen::Matrix3d R_EI = X_EW.R.toRotationMatrix() * matrix(data_->ximat + 9 * b);
    const Eigen::Vector3d r = com_E(b) - load.com_E;
    load.inertia_E +=
        R_EI * Eigen::Vector3d::Map(model_->body_inertia + 3 * b).asDiagonal() * R_EI.transpose();
    load.inertia_E +=
        model_->body_mass[b] * (r.squaredNorm() * Eigen::Matrix3d::Identity() - r * r.transpose());
  }
  return load;
}

int Simulation::body(const std::string& name) const { return find(mjOBJ_BODY, "body", name); }
int Simulation::site(const std::string& name) const { return find(mjOBJ_SITE, "site", name); }
int Simulation::geom(const std::string& name) const { return find(mjOBJ_GEOM, "geom", name); }

int Simulation::find(int type, const char* kind, const std::string& name) const {
  const int id = mj_name2id(model_.get(), type, name.c_str());
  if (id >= 0) return id;
  std::string names;
  for (int i = 0; const char* other = mj_id2name(model_.get(), type, i); ++i)
    names += std::string(i ? ", " : "") + other;
  throw std::runtime_error(path_ + ": the scene has no " + kind + " named `" + name +
                           "`; it has: " + names + ".");
}

}  // namespace tandem
