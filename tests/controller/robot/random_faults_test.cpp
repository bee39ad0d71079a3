// Whatever is commanded and whatever goes wrong, limits hold in every cycle and a fault ends in
// rest.
#include <array>
#include <cmath>
#include <string>

#include "base/random.h"
#include "controller/robot/robot_fixture.h"

namespace tandem {
namespace {

using namespace testing;

class RandomFaultsTest : public RobotFixture {
 protected:
  static Injection draw_injection(Random& random) {
    // Each kind is off in half of the seeds, else rare to frequent.
    const auto probability = [&] {
      return random.uniform(0, 1) < 0.5 ? 0.0 : std::pow(10.0, random.uniform(-4, -2));
    };
    Injection injection;
    injection.lost_commands = random.uniform(0, 0.5);
    injection.burst = probability();
    injection.burst_longest = 1 + static_cast<int>(random.uniform(0, 40));
    injection.corruption = probability();
    injection.corruption_jump = random.uniform(0, 20);
    injection.push = 10 * probability();
    injection.push_force = random.uniform(0, 200);
    injection.push_ms = 1 + static_cast<int>(random.uniform(0, 200));
    injection.user_stop = probability();
    injection.deaf_gripper = probability();
    return injection;
  }

  static JointVector noise(Random& random, double step) {
    JointVector noise;
    for (int i = 0; i < 7; ++i) noise[i] = random.uniform(-step, step);
    return noise;
  }

  void expect_limits(const std::string& when) {
    const RobotState& state = robot.state();
    ASSERT_TRUE(state.q.allFinite() && state.dq.allFinite() && state.tau_external.allFinite());
    for (int i = 0; i < 7; ++i)
      ASSERT_LE(std::abs(state.tau_measured[i]), i < 4 ? 87.0 : 12.0) << when << ", joint " << i;
    ASSERT_EQ(state.fault != Fault::none,
              state.mode == RobotMode::reflex || state.mode == RobotMode::user_stopped)
        << when;
    ASSERT_GE(state.success_rate, 0.0);
    ASSERT_LE(state.success_rate, 1.0);
  }
};

TEST_F(RandomFaultsTest, ArmRestsAfterEveryFaultAndStaysUntilRecovery) {
  int faulted = 0, recovered = 0;
  std::array<int, 24> seen{};
  for (uint64_t seed = 0; seed < 100; ++seed) {
    Random random{seed, 0x0b07};
    robot.place(home(), 0.04);
    if (!robot.recover()) FAIL() << "seed " << seed << ": an arm at home can be recovered";
    robot.inject(draw_injection(random));
    robot.seed_faults(seed);
    const double step = random.uniform(0.05, 1.0005);
    const bool holds = random.uniform(0, 1) < 0.5;
    const bool may_finish = random.uniform(0, 1) < 0.2;
    const std::string when = "seed " + std::to_string(seed);

    // A random walk of the torque, or the arm held at home with a noise that stays within the rate.
    bool finishing = false;
    for (int i = 0; i < 1500 && robot.state().fault == Fault::none; ++i) {
      robot.grip(random.uniform(0, 1) < 0.01 ? random.uniform(0, 0.08) : 0.04);
      finishing |= may_finish && random.uniform(0, 1) < 0.002;
      if (finishing) {
        finishing = !robot.finish();
      } else if (holds) {
        hold(robot, noise(random, 0.01 * step));
      } else {
        robot.write(robot.state().tau_commanded + noise(random, step));
      }
      expect_limits(when);
      if (HasFatalFailure()) return;
    }
    const Fault fault = robot.state().fault;
    if (fault == Fault::none) {
      robot.stop();
    } else {
      ++faulted;
      ++seen[static_cast<size_t>(fault)];
    }

    // Whatever comes now, the arm brakes, and it stands when the last push is over.
    const auto pass = [&] {
      const double way = random.uniform(0, 1);
      if (fault == Fault::none || way < 0.3) {
        robot.miss();
      } else if (way < 0.9) {
        robot.write(robot.state().tau_commanded + noise(random, 100.0));
      } else {
        robot.finish();
      }
      expect_limits(when);
    };
    for (int i = 0; i < 700; ++i) pass();
    const JointVector rest = robot.state().q;
    for (int i = 0; i < 200; ++i) pass();
    if (HasFatalFailure()) return;
    ASSERT_LT(speed(robot), 0.005) << when << ": " << fault_text(fault);
    ASSERT_LT((robot.state().q - rest).cwiseAbs().maxCoeff(), 1e-3) << when;
    ASSERT_EQ(robot.state().fault, fault) << when << ": the first fault stays";

    bool inside = true;
    for (int i = 0; i < 7; ++i) {
      inside &= robot.state().q[i] >= simulation.lower_limit(i) &&
                robot.state().q[i] <= simulation.upper_limit(i);
    }
    ASSERT_EQ(robot.recover(), inside || fault == Fault::none) << when;
    recovered += inside && fault != Fault::none;
  }
  EXPECT_GT(faulted, 50) << "the test must have faulted";
  EXPECT_GT(recovered, 25);
  for (const Fault fault : {Fault::communication_constraints_violation, Fault::torque_discontinuity,
                            Fault::user_stop, Fault::collision, Fault::joint_velocity_limit})
    EXPECT_GT(seen[static_cast<size_t>(fault)], 0) << fault_text(fault);
}

}  // namespace
}  // namespace tandem
