#include "controller/loop/control_loop.h"

#include <gtest/gtest.h>

#include "base/random.h"
#include "controller/rig.h"
#include "support/allocation_counter.h"

namespace tandem {
namespace {

using testing::Rig;

TEST(ControlLoop, TenThousandTicksDoNotAllocate) {
  Rig rig;
  rig.begin(1);
  Random random{1};
  const testing::AllocationCounter allocations;
  for (int step = 0; step < 100; ++step) {
    const StepSnapshot snapshot = rig.begin_step();
    // New chunks, hand-overs in both directions, contact with the block: everything that the loop
    // does.
    if (snapshot.chunk_id >= 0) {
      Action action = Action::Zero();
      for (int i = 0; i < 3; ++i) action[i] = random.uniform(-1, 1);
      action[2] -= 0.3;
      rig.loop.accept(Rig::constant_chunk(snapshot.chunk_id, step, action), snapshot.tick);
    }
    rig.loop.hear(Rig::human(Twist::Constant(random.uniform(-1, 1)), step % 7 < 2));
    rig.run_step();
  }
  EXPECT_EQ(allocations.count(), 0);
  EXPECT_EQ(rig.loop.ticks(), 10'000);
}

TEST(ControlLoop, ArmStandsStillWithoutAChunk) {
  Rig rig;
  rig.begin(2);
  rig.begin_step();
  const Pose start = rig.loop.arm().X_WE;
  for (int step = 0; step < 20; ++step) {
    const StepRecord record = rig.run_step();
    EXPECT_TRUE(record.executed.head<6>().isZero());
    rig.begin_step();
  }
  EXPECT_LT(minus(rig.loop.arm().X_WE, start).norm(),
            5e-4);  // m, rad; what the posture task leaks while it settles
}

TEST(ControlLoop, ExecutedActionIsTheAskedOneInFreeSpace) {
  Rig rig;
  rig.begin(3);
  Action asked = Action::Zero();
  asked << 0.4, -0.3, 0.5, 0.0, 0.0, 0.2, 0.0;
  for (int step = 0; step < 4; ++step) {
    const StepSnapshot snapshot = rig.begin_step();
    if (snapshot.chunk_id >= 0)
      rig.loop.accept(Rig::constant_chunk(snapshot.chunk_id, step, asked), snapshot.tick);
    const StepRecord record = rig.run_step();
    EXPECT_LT((record.executed.head<6>() - asked.head<6>()).cwiseAbs().maxCoeff(), 1e-9);
    EXPECT_EQ(record.chunk_index, step);
    EXPECT_EQ(record.policy_version, 1);
  }
}

TEST(ControlLoop, MaskedAxesNeverMove) {
  Rig rig;
  rig.begin(4);
  for (int step = 0; step < 5; ++step) {
    rig.begin_step();
    rig.loop.hear(Rig::human(Twist::Ones(), true));
    const StepRecord record = rig.run_step();
    EXPECT_EQ(record.executed[3], 0.0);
    EXPECT_EQ(record.executed[4], 0.0);
    EXPECT_EQ(record.human[3], 0.0);
  }
}

TEST(ControlLoop, StaticContactForceStaysBelowTheBound) {
  Rig rig;
  rig.begin(5);
  Twist down = Twist::Zero();
  down[0] = 0.3;  // beside the hole
  down[2] = -0.4;
  double force = 0.0;
  for (int step = 0; step < 60; ++step) {
    rig.begin_step();
    if (step == 12) down[0] = 0.0;
    rig.loop.hear(Rig::human(down, true));
    const StepRecord record = rig.run_step();
    if (step > 50) force = std::max(force, record.force_filtered_peak);
  }
  const double bound = rig.control.gains.stiffness[2] * rig.control.gains.error_clip[2];
  EXPECT_GT(force, 0.5 * bound);         // it does press
  EXPECT_LT(force, 1.05 * bound + 0.5);  // and never harder than it says
  // The commanded pose does not wind up while the arm is blocked.
  EXPECT_LE(std::abs(minus(rig.loop.commanded_pose(), rig.loop.arm().X_WE)[2]),
            rig.control.gains.error_clip[2] + 1e-3);
}

TEST(ControlLoop, HandOversJumpNeitherPoseNorTorque) {
  Rig rig;
  Random random{8};
  for (int episode = 0; episode < 6; ++episode) {
    rig.begin(100 + episode);
    bool engaged = false;
    Pose before = rig.loop.arm().X_WE;
    JointVector tau_before = JointVector::Zero();
    bool first = true;
    for (int step = 0; step < 20; ++step) {
      const StepSnapshot snapshot = rig.begin_step();
      if (snapshot.chunk_id >= 0) {
        Action action = Action::Zero();
        for (int i = 0; i < 6; ++i) action[i] = random.uniform(-1, 1);
        rig.loop.accept(Rig::constant_chunk(snapshot.chunk_id, step, action), snapshot.tick);
      }
      for (int tick = 0; tick < 100; ++tick) {
        if (random.uniform(0, 1) < 0.01) {
          engaged = !engaged;
          Twist twist;
          for (int i = 0; i < 6; ++i) twist[i] = random.uniform(-1, 1);
          rig.loop.hear(Rig::human(twist, engaged));
        }
        rig.drain();
        rig.loop.tick(0);
        const TickRecord& record = std::get<TickRecord>(*rig.records.front());
        const Twist jump = minus(record.X_WE_reference, before);
        if (!first) {
          ASSERT_LE(jump.head<3>().norm(), 0.0005);
          ASSERT_LE(jump.tail<3>().norm(), 0.005);
        }
        ASSERT_LE((record.tau_commanded - tau_before).cwiseAbs().maxCoeff(), 1.0);
        before = record.X_WE_reference;
        tau_before = record.tau_commanded;
        first = false;
      }
      rig.loop.end_step();
    }
    EXPECT_EQ(rig.robot.state().fault, Fault::none);
  }
}

TEST(ControlLoop, HumanStepIsMarkedAndHisActionKeptBesideThePolicys) {
  Rig rig;
  rig.begin(6);
  StepSnapshot snapshot = rig.begin_step();
  Action asked = Action::Zero();
  asked[0] = 0.5;
  rig.loop.accept(Rig::constant_chunk(snapshot.chunk_id, 0, asked), snapshot.tick);
  StepRecord record = rig.run_step();
  EXPECT_FALSE(record.intervention);
  rig.begin_step();
  Twist twist = Twist::Zero();
  twist[1] = 0.5;
  rig.loop.hear(Rig::human(twist, true));
  record = rig.run_step();
  EXPECT_TRUE(record.intervention);
  EXPECT_TRUE(record.took_over);
  EXPECT_EQ(record.human[1], 0.5);
  EXPECT_EQ(record.policy[0], 0.5);
  // The hand-over takes 50 of the 100 ticks, so most of the motion is the human's.
  EXPECT_GT(record.executed[1], 0.3);
  EXPECT_LT(record.executed[0], 0.2);
  EXPECT_GT(record.alpha_mean, 0.7);
}

TEST(ControlLoop, SilentHumanIsFirstHeldThenLetGo) {
  Rig rig;
  rig.begin(7);
  rig.begin_step();
  rig.loop.hear(Rig::human(Twist::Constant(0.5), true));
  rig.run_step();
  rig.begin_step();
  rig.loop.human_silent(rig.control.teleop_hold_ms + 1);
  EXPECT_LT(rig.run_step().executed.head<3>().norm(), 1e-9);
  EXPECT_GT(rig.loop.alpha(), 0.99);
  rig.begin_step();
  rig.loop.human_silent(rig.control.teleop_release_ms + 1);
  rig.run_step();
  EXPECT_EQ(rig.loop.alpha(), 0.0);
}

}  // namespace
}  // namespace tandem
