#include "controller/robot/robot_options.h"

#include <fstream>
#include <sstream>

#include "controller/robot/robot_fixture.h"

namespace tandem {
namespace {

using namespace testing;

class RobotOptionsTest : public ::testing::Test {
 protected:
  RobotOptionsTest() {
    std::ifstream file(std::string(TANDEM_ROOT) + "/config/controller.yaml");
    std::stringstream all;
    all << file.rdbuf();
    yaml_ = all.str();
  }
  void TearDown() override { std::remove(path_.c_str()); }

  /// The section `robot` of config/controller.yaml, with one text replaced.
  MujocoRobotOptions read(const std::string& from = "", const std::string& to = "") {
    std::string yaml = yaml_;
    const size_t at = yaml.find(from, yaml.find("robot:"));
    EXPECT_NE(at, std::string::npos) << from;
    yaml.replace(at, from.size(), to);
    std::ofstream(path_) << yaml;
    return read_robot(Section::load(path_).section("robot"));
  }
  std::string refusal(const std::string& from, const std::string& to) {
    try {
      read(from, to);
    } catch (const ScenarioError& error) {
      return error.what();
    }
    return "accepted";
  }

  std::string yaml_;
  const std::string path_ =
      ::testing::TempDir() + "robot_options_" + std::to_string(getpid()) + ".yaml";
};

TEST_F(RobotOptionsTest, FileAndCodeHaveTheSameDefaults) {
  const MujocoRobotOptions file = read(), code;
  EXPECT_EQ(file.contact_torque, code.contact_torque);
  EXPECT_EQ(file.collision_torque, code.collision_torque);
  EXPECT_EQ(file.contact_force, code.contact_force);
  EXPECT_EQ(file.collision_force, code.collision_force);
  EXPECT_EQ(file.gripper_speed, code.gripper_speed);
  EXPECT_EQ(file.gripper_force, code.gripper_force);
  EXPECT_EQ(file.gripper_latency_ms, code.gripper_latency_ms);
  EXPECT_EQ(file.inject.lost_commands, code.inject.lost_commands);
  EXPECT_EQ(file.inject.burst, code.inject.burst);
  EXPECT_EQ(file.inject.burst_longest, code.inject.burst_longest);
  EXPECT_EQ(file.inject.corruption, code.inject.corruption);
  EXPECT_EQ(file.inject.corruption_jump, code.inject.corruption_jump);
  EXPECT_EQ(file.inject.push, code.inject.push);
  EXPECT_EQ(file.inject.push_force, code.inject.push_force);
  EXPECT_EQ(file.inject.push_ms, code.inject.push_ms);
  EXPECT_EQ(file.inject.user_stop, code.inject.user_stop);
  EXPECT_EQ(file.inject.deaf_gripper, code.inject.deaf_gripper);
}

TEST_F(RobotOptionsTest, EveryKeyOfInjectIsRead) {
  EXPECT_EQ(read("lost_commands: 0", "lost_commands: 0.5").inject.lost_commands, 0.5);
  EXPECT_EQ(read("lost_bursts: {probability: 0", "lost_bursts: {probability: 0.5").inject.burst,
            0.5);
  EXPECT_EQ(read("longest: 25", "longest: 7").inject.burst_longest, 7);
  EXPECT_EQ(read("commands: {probability: 0, jump", "commands: {probability: 0.5, jump")
                .inject.corruption,
            0.5);
  EXPECT_EQ(read("jump_Nm: 5", "jump_Nm: 7").inject.corruption_jump, 7);
  EXPECT_EQ(read("pushes: {probability: 0", "pushes: {probability: 0.5").inject.push, 0.5);
  EXPECT_EQ(read("force_N: 30", "force_N: 7").inject.push_force, 7);
  EXPECT_EQ(read("duration_ms: 50", "duration_ms: 7").inject.push_ms, 7);
  EXPECT_EQ(read("user_stop: 0", "user_stop: 0.5").inject.user_stop, 0.5);
  EXPECT_EQ(read("deaf_gripper: 0", "deaf_gripper: 0.5").inject.deaf_gripper, 0.5);
}

TEST_F(RobotOptionsTest, CollisionThresholdBelowItsContactThresholdIsRefused) {
  const std::string said = refusal("collision_force: [100, 100", "collision_force: [100, 4");
  EXPECT_NE(said.find("robot.collision_force holds 4 at place 2, below the 5 of contact_force; a "
                      "collision threshold must be at least the contact threshold."),
            std::string::npos)
      << said;
}

TEST_F(RobotOptionsTest, ValueOutOfRangeAndUnknownKeyAreRefused) {
  EXPECT_NE(refusal("latency_ms: 200", "latency_ms: 501")
                .find("robot.gripper.latency_ms is 501; it must be in [0, 500]"),
            std::string::npos);
  EXPECT_NE(refusal("user_stop: 0", "user_stop: 2").find("it must be in [0, 1]"),
            std::string::npos);
  EXPECT_NE(refusal("deaf_gripper: 0", "deaf_griper: 0").find("inject.deaf_gripper is missing"),
            std::string::npos);
  EXPECT_NE(refusal("user_stop: 0", "user_stop: 0\n    lost_packets: 0").find("not a known key"),
            std::string::npos);
}

TEST_F(RobotOptionsTest, OptionOutOfRangeIsRefusedByTheRobot) {
  Simulation simulation(kArmScene);
  const auto refused = [&](auto&& spoil) {
    MujocoRobotOptions options;
    spoil(options);
    EXPECT_THROW(MujocoRobot(simulation, options), std::invalid_argument);
  };
  refused([](MujocoRobotOptions& o) { o.collision_torque[3] = 1.0; });
  refused([](MujocoRobotOptions& o) { o.collision_force[3] = 0.0; });
  refused([](MujocoRobotOptions& o) { o.contact_force[0] = 0.0; });
  refused([](MujocoRobotOptions& o) { o.gripper_speed = 0.0; });
  refused([](MujocoRobotOptions& o) { o.gripper_force = 150.0; });
  refused([](MujocoRobotOptions& o) { o.gripper_latency_ms = 501; });
  refused([](MujocoRobotOptions& o) { o.inject.push = -1.0; });
}

}  // namespace
}  // namespace tandem
