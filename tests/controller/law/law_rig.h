#pragma once

#include "base/random.h"
#include "controller/law/cartesian_impedance.h"
#include "controller/robot/scenes.h"
#include "controller/safety/safety_filter.h"

namespace tandem::testing {

inline Section controller_config() {
  return Section::load(std::string(TANDEM_ROOT) + "/config/controller.yaml");
}
inline const ImpedanceGains& default_gains() {
  static const ImpedanceGains gains = read_gains(controller_config().section("law"));
  return gains;
}
inline SafetySettings default_safety() {
  return read_safety(controller_config().section("safety"));
}

inline Twist six(double linear, double angular) {
  Twist v;
  v << linear, linear, linear, angular, angular, angular;
  return v;
}

inline Twist random_twist(Random& random, double linear, double angular) {
  Twist v;
  for (int i = 0; i < 6; ++i) v[i] = random.uniform(-1.0, 1.0);
  return v.cwiseProduct(six(linear, angular));
}

inline Eigen::Quaterniond random_rotation(Random& random) {
  Eigen::Quaterniond R(random.normal(1), random.normal(1), random.normal(1), random.normal(1));
  return R.normalized();
}

/// Symmetric, positive definite, all axes coupled, about as large as the default gains.
inline Matrix6 random_stiffness(Random& random) {
  Matrix6 A;
  for (int i = 0; i < 36; ++i) A(i) = random.normal(1.0);
  const Twist scale = six(25.0, 6.0);
  const Matrix6 shape = A * A.transpose() / 6.0 + 0.5 * Matrix6::Identity();
  return scale.asDiagonal() * shape * scale.asDiagonal();
}

/// Law and safety filter around a simulated arm, without robot contract or loop: reference in,
/// motion out.
struct LawRig {
  Simulation simulation;
  ArmModel model{kUrdf};
  CartesianImpedance law;
  SafetyFilter filter;
  ArmState arm;
  PoseReference reference;
  JointVector requested = JointVector::Zero(), tau = JointVector::Zero();

  explicit LawRig(const ImpedanceGains& gains = default_gains(),
                  const std::string& scene = kArmScene,
                  const Eigen::Vector3d& low = Eigen::Vector3d::Constant(-2.0),
                  const Eigen::Vector3d& high = Eigen::Vector3d::Constant(2.0))
      : simulation(scene), law(gains), filter(default_safety(), model, low, high) {
    model.set_load(simulation.held_load());
    place(home());
  }

  /// At rest at q, with the reference where the tool is.
  void place(const JointVector& q) {
    simulation.set_arm(q, kPegWidth);
    tau.setZero();
    measure();
    reference = PoseReference{arm.X_WE, Twist::Zero()};
  }

  void measure() { model.update(simulation.q(), simulation.dq(), arm); }

  /// One millisecond of the law, or of any other request.
  void tick() {
    measure();
    apply(law.torque(arm, reference));
  }
  void apply(const JointVector& request) {
    requested = request;
    tau = filter.limit(arm, requested, tau);
    const Eigen::Vector2d slip =
        simulation.finger_position() - Eigen::Vector2d::Constant(0.5 * kPegWidth);
    simulation.step(tau, -2000.0 * slip - 30.0 * simulation.finger_velocity());
    measure();
  }
  void run(int ticks) {
    for (int i = 0; i < ticks; ++i) tick();
  }

  /// Pushes on the hand until the next call: force and moment about E, base axes.
  void push(const Wrench& F) {
    const int hand = simulation.body("hand");
    mjData* data = simulation.data();
    const Eigen::Vector3d lever =
        simulation.tool_pose().p - Eigen::Vector3d::Map(data->xipos + 3 * hand);
    Eigen::Vector3d::Map(data->xfrc_applied + 6 * hand) = F.head<3>();
    Eigen::Vector3d::Map(data->xfrc_applied + 6 * hand + 3) =
        F.tail<3>() + lever.cross(F.head<3>());
  }

  double kinetic_energy() { return 0.5 * arm.dq.dot(model.mass(arm.q) * arm.dq); }

  /// Of the clipped spring, for diagonal stiffness in base axes and small rotations.
  double spring_energy() const {
    const ImpedanceGains& gains = law.gains();
    const Twist e = minus(reference.X_WE, arm.X_WE);
    double energy = 0.0;
    for (int i = 0; i < 6; ++i) {
      const double c = e[i] > 0.0 ? gains.clip_high[i] : gains.clip_low[i], a = std::abs(e[i]);
      energy += gains.stiffness(i, i) * (a <= c ? 0.5 * a * a : c * a - 0.5 * c * c);
    }
    return energy;
  }
};

}  // namespace tandem::testing
