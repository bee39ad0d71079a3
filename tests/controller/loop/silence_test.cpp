#include <gtest/gtest.h>

#include "base/random.h"
#include "controller/rig.h"

/// What the loop makes of sources that fall silent, and of orders to stop.
namespace tandem {
namespace {

using testing::Rig;

class Silence : public ::testing::Test {
 protected:
  /// Ticks until the clock has moved by `ms`.
  void pass(int ms, double link_age_ms = 0.0) {
    for (int i = 0; i < ms; ++i) {
      rig.tick(link_age_ms);
      rig.drain();
    }
  }
  double speed() const { return rig.robot.state().dq.norm(); }                // rad/s
  double tool_speed() const { return rig.loop.arm().V_WE.head<3>().norm(); }  // m/s

  Rig rig;
  const WatchdogSettings& watchdog = rig.control.watchdog;
};

TEST_F(Silence, OfThePolicyHoldsThenDampsThenStops) {
  rig.begin(1);
  rig.begin_step();
  Action asked = Action::Zero();
  asked[0] = asked[1] = 0.5;
  rig.loop.accept(rig.constant_chunk(0, 0, asked));
  pass(100);
  EXPECT_GT(speed(), 0.01);
  rig.loop.end_step();
  // The episode goes on past the chunk's end without a new one.
  for (int step = 1; step < Rig::kHorizon; ++step) {
    rig.begin_step();
    rig.run_step();
  }
  rig.begin_step();
  pass(static_cast<int>(watchdog.policy.hold_after_ms) + 400);
  EXPECT_EQ(rig.loop.grades()[0], Grade::hold);
  EXPECT_LT(tool_speed(), 0.005);
  EXPECT_EQ(rig.loop.law().stiffness_share(), 1.0);
  pass(static_cast<int>(watchdog.policy.damp_after_ms) + CartesianImpedance::kFadeTicks);
  EXPECT_EQ(rig.loop.grades()[0], Grade::damp);
  EXPECT_EQ(rig.loop.law().stiffness_share(), 0.0);
  EXPECT_EQ(rig.loop.fault(), Fault::none);
  pass(static_cast<int>(watchdog.policy.stop_after_ms));
  EXPECT_EQ(rig.loop.fault(), Fault::policy_silent);
  pass(500);
  EXPECT_LT(speed(), 1e-3);
  EXPECT_NE(rig.robot.state().mode, RobotMode::moving);
}

TEST_F(Silence, OfTheHumanInATrainingEpisodeEndsInTheHandsOfThePolicy) {
  rig.begin(2, Phase::training);
  rig.begin_step();
  rig.hear(Twist::Constant(0.5), true);
  pass(100);
  EXPECT_GT(rig.loop.end_step().executed.head<3>().norm(), 0.1);
  rig.begin_step();
  pass(static_cast<int>(watchdog.operator_.hold_after_ms));
  rig.begin_step();
  const Pose held = rig.loop.commanded_pose();
  pass(100);
  EXPECT_EQ(rig.loop.grades()[1], Grade::hold);
  EXPECT_EQ(minus(rig.loop.commanded_pose(), held).norm(), 0.0);
  EXPECT_EQ(rig.loop.alpha(), 1.0);
  pass(static_cast<int>(watchdog.operator_release_after_ms) + rig.control.ramp_out_ticks);
  EXPECT_EQ(rig.loop.alpha(), 0.0);
  EXPECT_EQ(rig.loop.grades()[1], Grade::fresh);
}

TEST_F(Silence, OfTheHumanInADemonstrationStopsTheArm) {
  rig.begin(3, Phase::demonstration);
  rig.begin_step();
  rig.hear(Twist::Constant(0.3), true);
  pass(static_cast<int>(watchdog.operator_.damp_after_ms) + 10);
  EXPECT_EQ(rig.loop.grades()[1], Grade::damp);
  pass(static_cast<int>(watchdog.operator_.stop_after_ms));
  EXPECT_EQ(rig.loop.fault(), Fault::operator_silent);
  pass(500);
  EXPECT_LT(speed(), 1e-3);
}

TEST_F(Silence, OfTheLinkCountsWhoeverDrives) {
  rig.begin(4);
  rig.begin_step();
  rig.loop.accept(rig.constant_chunk(0, 0, Action::Constant(0.5)));
  pass(50, watchdog.link.hold_after_ms + 1);
  EXPECT_EQ(rig.loop.grades()[2], Grade::hold);
  EXPECT_EQ(rig.loop.end_step().executed.head<6>().norm(), 0.0);
  rig.begin_step();
  pass(CartesianImpedance::kFadeTicks, watchdog.link.damp_after_ms + 1);
  EXPECT_EQ(rig.loop.law().stiffness_share(), 0.0);
  pass(1, watchdog.link.stop_after_ms + 1);
  EXPECT_EQ(rig.loop.fault(), Fault::link_silent);
}

TEST_F(Silence, ThatIsShortLeavesNoTrace) {
  // Two equal episodes, one of them with silences just below every limit.
  Pose ends[2];
  for (int silent = 0; silent < 2; ++silent) {
    rig.begin(5);
    rig.begin_step();
    rig.loop.accept(rig.constant_chunk(0, 0, Action::Constant(0.3)));
    pass(100, silent ? watchdog.link.hold_after_ms : 0.0);
    ends[silent] = rig.loop.arm().X_WE;
    EXPECT_EQ(rig.loop.fault(), Fault::none);
  }
  EXPECT_EQ(minus(ends[0], ends[1]).norm(), 0.0);
}

TEST_F(Silence, ADampedArmYieldsAndDoesNotSpringBack) {
  rig.begin(6, Phase::demonstration);
  rig.begin_step();
  rig.hear(Twist::Zero(), false);
  const double damp_ms = watchdog.link.damp_after_ms + 1;
  pass(CartesianImpedance::kFadeTicks, damp_ms);
  // Somebody pushes it aside.
  const Pose before = rig.loop.arm().X_WE;
  mjtNum* push = rig.simulation.data()->xfrc_applied + 6 * rig.simulation.body("hand");
  push[0] = 10.0;
  pass(500, damp_ms);
  push[0] = 0.0;
  pass(200, damp_ms);
  const Pose pushed = rig.loop.arm().X_WE;
  EXPECT_GT(minus(pushed, before)[0], 0.01);
  EXPECT_EQ(rig.loop.fault(), Fault::none);
  // The link is back: stiff again, where it is.
  Pose last = rig.loop.reference().X_WE;
  for (int i = 0; i < 800; ++i) {
    pass(1);
    ASSERT_LE(minus(rig.loop.reference().X_WE, last).head<3>().norm(), 0.0005);
    last = rig.loop.reference().X_WE;
  }
  EXPECT_EQ(rig.loop.law().stiffness_share(), 1.0);
  EXPECT_LT(minus(rig.loop.arm().X_WE, pushed).head<3>().norm(), 0.003);
}

TEST_F(Silence, AnEmergencyStopBrakesAtOnceAndStaysUntilTheNextEpisode) {
  rig.begin(7);
  rig.begin_step();
  rig.loop.accept(rig.constant_chunk(0, 0, Action::Constant(1.0)));
  pass(100);
  EXPECT_GT(speed(), 0.05);
  rig.loop.stop(Fault::estop);
  rig.loop.stop(Fault::policy_silent);  // what follows says nothing
  pass(300);
  EXPECT_EQ(rig.loop.fault(), Fault::estop);
  EXPECT_LT(speed(), 1e-3);
  EXPECT_TRUE(rig.robot.recover());
  rig.begin(8);
  EXPECT_EQ(rig.loop.fault(), Fault::none);
  rig.begin_step();
  rig.loop.accept(rig.constant_chunk(0, 0, Action::Constant(0.5)));
  pass(100);
  EXPECT_GT(speed(), 0.01);
}

TEST_F(Silence, AFaultOfTheRobotIsTheLoopsAndEndsItsTicks) {
  rig.begin(9);
  rig.begin_step();
  pass(10);
  for (int i = 0; i < 20; ++i) rig.robot.miss();
  rig.tick();
  EXPECT_EQ(rig.records.front(), nullptr);  // nothing is computed for an arm that has stopped
  EXPECT_EQ(rig.loop.fault(), Fault::communication_constraints_violation);
  const int64_t ticks = rig.loop.ticks();
  EXPECT_EQ(ticks, 10);
  pass(10);
  EXPECT_EQ(rig.loop.ticks(), ticks);
}

}  // namespace
}  // namespace tandem
