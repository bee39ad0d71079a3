#include "controller/robot/model_check.h"

#include <cmath>
#include <cstdio>
#include <random>
#include <stdexcept>

namespace tandem {
namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Compares one quantity, keeps the largest relative error, and throws at the first entry that is
// out of bounds.
void compare(const char* quantity, const Eigen::MatrixXd& urdf, const Eigen::MatrixXd& robot,
             double bound, const char* mend, const std::string& scene, double& worst) {
  const double scale = std::max(1.0, robot.cwiseAbs().maxCoeff());
  Eigen::Index row = 0, column = 0;
  const double error = (urdf - robot).cwiseAbs().maxCoeff(&row, &column) / scale;
  worst = std::max(worst, error);
  if (error <= bound) return;
  const std::string where = robot.cols() > 1
                                ? std::to_string(row + 1) + ", " + std::to_string(column + 1)
                                : std::to_string(row + 1);
  char text[800];
  std::snprintf(text, sizeof text,
                "%s: the law's model and the robot's disagree: %s [%s] is %.9g by the URDF and "
                "%.9g in the simulator "
                "(relative error %.2g, allowed %.2g). Mend %s.",
                scene.c_str(), quantity, where.c_str(), urdf(row, column), robot(row, column),
                error, bound, mend);
  throw std::runtime_error(text);
}

}  // namespace

ModelErrors check_model(const Simulation& simulation, ArmModel& arm, double bound, int states,
                        uint64_t seed) {
  const mjModel* model = simulation.model();
  const std::unique_ptr<mjData, void (*)(mjData*)> data(mj_makeData(model), mj_deleteData);
  const int nv = model->nv, v = simulation.arm_dof(), tool = simulation.site("tool");
  std::mt19937_64 random(seed);
  const auto uniform = [&random](double low, double high) {
    return low + (high - low) * static_cast<double>(random() >> 11) * 0x1.0p-53;
  };

  ModelErrors worst;
  ArmState state;
  Eigen::VectorXd bias(nv);
  RowMajor M(nv, nv), J(6, nv);
  for (int sample = 0; sample < states; ++sample) {
    JointVector q, dq;
    for (int i = 0; i < 7; ++i) {
      q[i] = uniform(arm.lower_limit()[i], arm.upper_limit()[i]);
      dq[i] = uniform(-arm.velocity_limit()[i], arm.velocity_limit()[i]);
    }
    mj_resetData(model, data.get());
    JointVector::Map(data->qpos + simulation.arm_qpos()) = q;
    for (int finger = 0; finger < 2; ++finger)
      data->qpos[simulation.finger_qpos(finger)] = 0.5 * arm.gripper_width();
    mj_fwdPosition(model, data.get());
    mj_fwdVelocity(model, data.get());
    const JointVector gravity = JointVector::Map(data->qfrc_bias + v);
    JointVector::Map(data->qvel + v) = dq;
    mj_fwdVelocity(model, data.get());
    const JointVector coriolis = JointVector::Map(data->qfrc_bias + v) - gravity;
    mj_fullM(model, M.data(), data->qM);
    mj_jacSite(model, data.get(), J.data(), J.data() + 3 * nv, tool);
    const Eigen::Vector3d p_WE = Eigen::Vector3d::Map(data->site_xpos + 3 * tool);
    const Eigen::Matrix3d R_WE =
        Eigen::Matrix<double, 3, 3, Eigen::RowMajor>::Map(data->site_xmat + 9 * tool);

    arm.update(q, dq, state);
    const auto check = [&](const char* quantity, const Eigen::MatrixXd& urdf,
                           const Eigen::MatrixXd& robot, const char* mend, double& error) {
      compare(quantity, urdf, robot, bound, mend, simulation.path(), error);
    };
    const char frames[] =
        "the origins of joints, hand and tool frame in panda.urdf or panda.xml (p in m, R as a "
        "matrix)";
    const char inertias[] =
        "mass, centre or inertia of the links, the hand or the object in hand "
        "(ArmModel::set_load), or the armature";
    check("tool position p_WE", state.X_WE.p, p_WE, frames, worst.pose);
    check("tool orientation R_WE", state.X_WE.R.toRotationMatrix(), R_WE, frames, worst.pose);
    check("Jacobian", state.J, J.middleCols<7>(v), frames, worst.jacobian);
    check("mass matrix", arm.mass(q), M.block<7, 7>(v, v), inertias, worst.mass);
    check("gravity torque", arm.gravity(q), gravity, inertias, worst.gravity);
    check("Coriolis torque", state.coriolis, coriolis, inertias, worst.coriolis);
  }
  return worst;
}

}  // namespace tandem
