#include "controller/robot/fault_injection.h"

#include <functional>
#include <set>
#include <string>
#include <vector>

#include "controller/robot/robot_fixture.h"

namespace tandem {
namespace {

using namespace testing;

//------------------------------ the draws ------------------------------

Injection everything(double probability) {
  Injection injection;
  injection.lost_commands = injection.burst = injection.corruption = probability;
  injection.push = injection.user_stop = injection.deaf_gripper = probability;
  return injection;
}

/// One letter per thing that goes wrong, cycle by cycle.
std::string story(FaultInjection& injection, int cycles, const std::string& kinds = "LCPSG") {
  std::string told;
  for (int i = 0; i < cycles; ++i) {
    Eigen::Vector3d force;
    JointVector tau = JointVector::Zero();
    const bool lost = injection.loses_command();
    injection.corrupt(tau);
    const bool happened[5] = {lost, !tau.isZero(0.0), injection.pushes(force), injection.stops(),
                              injection.misses_grip()};
    for (int k = 0; k < 5; ++k) {
      const char letter = "LCPSG"[k];
      if (happened[k] && kinds.find(letter) != std::string::npos) told += letter;
    }
    told += '.';
  }
  return told;
}

TEST(FaultInjection, EpisodeDrawsTheSameFaultsWhateverCameBefore) {
  FaultInjection fresh(everything(0.05)), used(everything(0.05));
  fresh.seed(7);
  const std::string expected = story(fresh, 2000);
  used.seed(3);
  story(used, 777);
  used.seed(7);
  EXPECT_EQ(story(used, 2000), expected);
  used.seed(8);
  EXPECT_NE(story(used, 2000), expected);
}

TEST(FaultInjection, OneKindMoreLeavesTheOthersWhereTheyWere) {
  FaultInjection all(everything(0.05));
  all.seed(7);
  const std::string in_all = story(all, 2000, "P");
  Injection pushes_only;
  pushes_only.push = 0.05;
  FaultInjection alone(pushes_only);
  alone.seed(7);
  EXPECT_EQ(story(alone, 2000), in_all);
}

TEST(FaultInjection, HappensAsOftenAsAskedAndZeroIsNever) {
  FaultInjection some(everything(0.01)), none{Injection{}};
  Injection single = everything(0.01);
  single.burst = 0.0;
  FaultInjection without_bursts(single);
  story(some, 100'000);
  story(none, 100'000);
  story(without_bursts, 100'000);
  for (const int64_t count :
       {some.counts().corruptions, some.counts().pushes, some.counts().user_stops,
        some.counts().deaf_grips, without_bursts.counts().lost_commands})
    EXPECT_NEAR(static_cast<double>(count), 1000.0, 150.0);
  EXPECT_GT(some.counts().lost_commands, 8000) << "bursts of 13 on average";
  EXPECT_EQ(none.counts().lost_commands + none.counts().corruptions + none.counts().pushes +
                none.counts().user_stops + none.counts().deaf_grips,
            0);
}

TEST(FaultInjection, BurstsHaveEveryLengthUpToTheLongest) {
  Injection injection;
  injection.burst = 0.001;
  injection.burst_longest = 6;
  FaultInjection bursts(injection);
  std::set<size_t> lengths;
  std::string run = story(bursts, 200'000);
  for (size_t at = run.find("L."); at != std::string::npos; at = run.find("L.", at)) {
    size_t length = 0;
    while (run.compare(at, 2, "L.") == 0) ++length, at += 2;
    lengths.insert(length);
  }
  for (size_t length = 1; length <= 6; ++length) EXPECT_EQ(lengths.count(length), 1u) << length;
}

TEST(FaultInjection, PushesHaveTheirForceAndEveryDirection) {
  Injection injection;
  injection.push = 1.0;
  injection.push_force = 12.5;
  FaultInjection pushes(injection);
  Eigen::Vector3d mean = Eigen::Vector3d::Zero(), force;
  for (int i = 0; i < 10'000; ++i) {
    ASSERT_TRUE(pushes.pushes(force));
    ASSERT_NEAR(force.norm(), 12.5, 1e-9);
    mean += force / 10'000;
  }
  EXPECT_LT(mean.norm(), 0.5);
}

TEST(FaultInjection, ValueOutOfRangeIsRefusedInASentence) {
  const auto refusal = [](const std::function<void(Injection&)>& spoil) {
    Injection injection;
    spoil(injection);
    try {
      FaultInjection refused(injection);
    } catch (const std::invalid_argument& error) {
      return std::string(error.what());
    }
    return std::string("accepted");
  };
  EXPECT_EQ(refusal([](Injection& i) { i.lost_commands = 1.5; }),
            "Injection lost_commands is 1.5; it must be in [0, 1].");
  for (const double bad : {-0.1, 1.1, std::nan("")}) {
    EXPECT_NE(refusal([&](Injection& i) { i.burst = bad; }), "accepted");
    EXPECT_NE(refusal([&](Injection& i) { i.corruption = bad; }), "accepted");
    EXPECT_NE(refusal([&](Injection& i) { i.push = bad; }), "accepted");
    EXPECT_NE(refusal([&](Injection& i) { i.user_stop = bad; }), "accepted");
    EXPECT_NE(refusal([&](Injection& i) { i.deaf_gripper = bad; }), "accepted");
  }
  EXPECT_NE(refusal([](Injection& i) { i.burst_longest = 0; }), "accepted");
  EXPECT_NE(refusal([](Injection& i) { i.corruption_jump = 101; }), "accepted");
  EXPECT_NE(refusal([](Injection& i) { i.push_force = -1; }), "accepted");
  EXPECT_NE(refusal([](Injection& i) { i.push_ms = 0; }), "accepted");
}

//------------------------------ what the robot makes of them ------------------------------

class InjectedRobotTest : public RobotFixture {
 protected:
  void inject(const std::function<void(Injection&)>& set) {
    Injection injection;
    set(injection);
    robot.inject(injection);
  }
  /// Cycles of holding still until the fault, at most `cycles`.
  int hold_until_fault(int cycles) {
    for (int i = 0; i < cycles; ++i) {
      hold(robot);
      if (robot.state().fault != Fault::none) return i + 1;
    }
    return cycles;
  }
};

TEST_F(InjectedRobotTest, LostCommandsAreMissesAndTheLastTorqueIsUsedAgain) {
  inject([](Injection& i) { i.lost_commands = 0.1; });
  int lost = 0;
  for (int i = 0; i < 1000; ++i) {
    const JointVector before = robot.state().tau_commanded;
    robot.write(on_joint(0, i % 2 == 0 ? 0.1 : 0.2));
    if (robot.state().tau_commanded == before) {
      ++lost;
      EXPECT_EQ(robot.state().tau_measured, before);
    }
  }
  EXPECT_EQ(robot.state().fault, Fault::none);
  // After a lost command the next but one is the same torque: fewer changes than losses.
  EXPECT_GT(lost, 50);
  EXPECT_NEAR(static_cast<double>(robot.injected().lost_commands), 100.0, 40.0);
  EXPECT_NEAR(robot.state().success_rate, 0.9, 0.1);
}

TEST_F(InjectedRobotTest, TwentyLostCommandsViolateTheConstraintsAndShorterBurstsDoNot) {
  hold(robot);
  inject([](Injection& i) { i.lost_commands = 1.0; });
  EXPECT_EQ(hold_until_fault(100), 20);
  EXPECT_EQ(robot.state().fault, Fault::communication_constraints_violation);
  ASSERT_TRUE(robot.recover());

  inject([](Injection& i) { i.burst = 0.002, i.burst_longest = 19; });
  EXPECT_EQ(hold_until_fault(20'000), 20'000);
  EXPECT_EQ(robot.state().fault, Fault::none);
  EXPECT_GT(robot.injected().lost_commands, 200);

  inject([](Injection& i) { i.burst = 0.01, i.burst_longest = 60; });
  EXPECT_LT(hold_until_fault(20'000), 20'000);
  EXPECT_EQ(robot.state().fault, Fault::communication_constraints_violation);
}

TEST_F(InjectedRobotTest, LostCommandsDoNotStartAMotion) {
  inject([](Injection& i) { i.lost_commands = 1.0; });
  for (int i = 0; i < 100; ++i) robot.write(JointVector::Zero());
  EXPECT_EQ(robot.state().mode, RobotMode::idle);
  EXPECT_EQ(robot.state().fault, Fault::none);
}

TEST_F(InjectedRobotTest, LostFinishIsAMiss) {
  swing();
  inject([](Injection& i) { i.lost_commands = 1.0; });
  for (int i = 0; i < 19; ++i) ASSERT_FALSE(robot.finish());
  EXPECT_TRUE(robot.finish());
  EXPECT_EQ(robot.state().fault, Fault::communication_constraints_violation);
}

TEST_F(InjectedRobotTest, CorruptedCommandIsADiscontinuityAndIsNotApplied) {
  inject([](Injection& i) { i.corruption = 0.01; });
  const int cycles = hold_until_fault(5000);
  EXPECT_LT(cycles, 2000);
  EXPECT_EQ(robot.state().fault, Fault::torque_discontinuity);
  EXPECT_EQ(robot.injected().corruptions, 1);
  EXPECT_LT(robot.state().tau_measured.cwiseAbs().maxCoeff(), 1.0);
  expect_held(300);
}

TEST_F(InjectedRobotTest, SmallCorruptionPassesAsATorque) {
  inject([](Injection& i) { i.corruption = 0.5, i.corruption_jump = 0.4; });
  double largest = 0.0;
  for (int i = 0; i < 200; ++i) {
    robot.write(JointVector::Zero());
    largest = std::max(largest, robot.state().tau_measured.cwiseAbs().maxCoeff());
  }
  EXPECT_EQ(robot.state().fault, Fault::none);
  EXPECT_EQ(largest, 0.4);
}

TEST_F(InjectedRobotTest, PushIsFeltForItsTimeAndIsNoFaultBelowTheThreshold) {
  hold(robot);
  inject([](Injection& i) { i.push = 1.0, i.push_force = 20.0, i.push_ms = 40; });
  int contact_cycles = 0;
  for (int i = 0; i < 40; ++i) {
    hold(robot);
    EXPECT_NEAR(simulation.contact_wrench().head<3>().norm(), 20.0, 1e-9);
    for (const int8_t flag : robot.state().contact_W) contact_cycles += flag != 0;
  }
  EXPECT_EQ(robot.injected().pushes, 1) << "one at a time";
  EXPECT_GT(contact_cycles, 5);
  inject([](Injection&) {});
  hold(robot);
  EXPECT_EQ(simulation.contact_wrench().norm(), 0.0);
  EXPECT_EQ(robot.state().fault, Fault::none);
}

TEST_F(InjectedRobotTest, HardPushIsACollision) {
  MujocoRobotOptions options;
  options.collision_force.head<3>().setConstant(25.0);
  options.inject.push = 0.01, options.inject.push_force = 60.0, options.inject.push_ms = 100;
  MujocoRobot careful(simulation, options);
  careful.place(home(), 0.04);
  for (int i = 0; i < 2000 && careful.state().fault == Fault::none; ++i) hold(careful);
  EXPECT_EQ(careful.state().fault, Fault::collision);
  EXPECT_EQ(careful.injected().pushes, 1);
  for (int i = 0; i < 500; ++i) careful.miss();
  EXPECT_LT(speed(careful), 1e-3);
  EXPECT_TRUE(careful.recover());
}

TEST_F(InjectedRobotTest, TappedStopButtonNeedsRecoveryOnly) {
  inject([](Injection& i) { i.user_stop = 0.01; });
  EXPECT_LT(hold_until_fault(2000), 2000);
  EXPECT_EQ(robot.state().fault, Fault::user_stop);
  EXPECT_EQ(robot.state().mode, RobotMode::user_stopped);
  EXPECT_EQ(robot.injected().user_stops, 1);
  for (int i = 0; i < 200; ++i) robot.miss();
  EXPECT_TRUE(robot.recover());
}

TEST_F(InjectedRobotTest, DeafGripperMissesATargetHoweverOftenItIsRepeatedAndHearsTheNext) {
  inject([](Injection& i) { i.deaf_gripper = 1.0; });
  for (int i = 0; i < 500; ++i) {
    robot.grip(0.08);
    hold(robot);
  }
  EXPECT_NEAR(robot.state().gripper_width, 0.04, 1e-4);
  EXPECT_EQ(robot.injected().deaf_grips, 1);
  inject([](Injection&) {});
  robot.grip(0.06);
  for (int i = 0; i < 500; ++i) hold(robot);
  EXPECT_NEAR(robot.state().gripper_width, 0.06, 5e-4);
}

TEST_F(InjectedRobotTest, NothingHappensToARobotThatDoesNotMove) {
  robot.inject(everything(1.0));
  for (int i = 0; i < 1000; ++i) robot.miss();
  EXPECT_EQ(robot.state().fault, Fault::none);
  EXPECT_EQ(robot.injected().pushes + robot.injected().user_stops, 0);
}

TEST_F(InjectedRobotTest, SeededEpisodeRepeatsBitForBitAfterAnyOther) {
  Injection injection = everything(0.002);
  injection.user_stop = injection.corruption = 0.0002;
  injection.burst_longest = 22;
  robot.inject(injection);
  const auto episode = [&](uint64_t seed) {
    robot.place(home(), 0.04);
    robot.recover();
    robot.seed_faults(seed);
    for (int i = 0; i < 3000; ++i) {
      robot.grip(i % 200 < 100 ? 0.02 : 0.05);
      hold(robot);
    }
    std::vector<double> end(robot.state().q.begin(), robot.state().q.end());
    end.push_back(robot.state().gripper_width);
    end.push_back(static_cast<double>(robot.state().fault));
    robot.stop();
    return end;
  };
  const std::vector<double> first = episode(11);
  for (const uint64_t other : {12, 13}) EXPECT_NE(episode(other), first);
  EXPECT_EQ(episode(11), first);
}

}  // namespace
}  // namespace tandem
