#include "controller/robot/robot_options.h"

#include <sstream>
#include <stdexcept>
#include <string>

namespace tandem {
namespace {

std::string show(double value) {
  std::ostringstream out;
  out << value;
  return out.str();
}

void require(bool good, const char* name, double value, const char* range) {
  if (good) return;
  throw std::invalid_argument(std::string("Robot option ") + name + " is " + show(value) +
                              "; it must be " + range + ".");
}

template <int size>
Eigen::Matrix<double, size, 1> read_thresholds(Section& section, const std::string& key,
                                               double high) {
  return Eigen::Matrix<double, size, 1>::Map(
      section.numbers(key, static_cast<size_t>(size), 0.1, high).data());
}

// A collision is also a contact.
template <typename Vector>
void order(const Section& section, const std::string& contact_key, const Vector& contact,
           const std::string& collision_key, const Vector& collision) {
  for (int i = 0; i < contact.size(); ++i) {
    if (contact[i] <= collision[i]) continue;
    throw ScenarioError(section.place(collision_key) + " holds " + show(collision[i]) +
                        " at place " + std::to_string(i + 1) + ", below the " + show(contact[i]) +
                        " of " + contact_key +
                        "; a collision threshold must be at least the contact threshold.");
  }
}

}  // namespace

MujocoRobotOptions read_robot(Section section) {
  MujocoRobotOptions options;
  options.contact_torque = read_thresholds<7>(section, "contact_torque_Nm", 87.0);
  options.collision_torque = read_thresholds<7>(section, "collision_torque_Nm", 87.0);
  options.contact_force = read_thresholds<6>(section, "contact_force", 1000.0);
  options.collision_force = read_thresholds<6>(section, "collision_force", 1000.0);
  order(section, "contact_torque_Nm", options.contact_torque, "collision_torque_Nm",
        options.collision_torque);
  order(section, "contact_force", options.contact_force, "collision_force",
        options.collision_force);
  Section gripper = section.section("gripper");
  options.gripper_speed = gripper.number("speed_m_s", 0.001, 1.0);
  options.gripper_force = gripper.number("force_N", 1.0, 140.0);
  options.gripper_latency_ms =
      static_cast<int>(gripper.integer("latency_ms", 0, kLongestGripperLatencyMs));
  gripper.finish();
  options.inject = read_injection(section.section("inject"));
  section.finish();
  return options;
}

void check(const MujocoRobotOptions& options) {
  const auto ordered = [](const auto& contact, const auto& collision) {
    return contact.minCoeff() > 0 && (contact.array() <= collision.array()).all();
  };
  require(ordered(options.contact_torque, options.collision_torque), "contact_torque",
          options.contact_torque.minCoeff(), "above 0 N m and at most collision_torque");
  require(ordered(options.contact_force, options.collision_force), "contact_force",
          options.contact_force.minCoeff(), "above 0 and at most collision_force");
  require(options.gripper_speed > 0 && options.gripper_speed <= 1, "gripper_speed",
          options.gripper_speed, "in (0, 1] m/s");
  require(options.gripper_force > 0 && options.gripper_force <= 140, "gripper_force",
          options.gripper_force, "in (0, 140] N");
  require(options.gripper_latency_ms >= 0 && options.gripper_latency_ms <= kLongestGripperLatencyMs,
          "gripper_latency_ms", options.gripper_latency_ms, "in [0, 500] ms");
}

}  // namespace tandem
