#include "controller/loop/control_loop.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <thread>

#include "base/random.h"
#include "controller/link/policy_loader.h"
#include "controller/loop/policy_worker.h"
#include "controller/rig.h"
#include "policy_runtime/policy_file.h"
#include "support/allocation_counter.h"

namespace tandem {
namespace {

using testing::Rig;

TEST(ControlLoop, HundredThousandTicksDoNotAllocate) {
  Rig rig;
  rig.begin(1, Phase::training);
  // Policies come from another thread, as the loader's.
  policy::PolicySlot slot;
  const auto publish = [&](int version) {
    std::thread loader([&] {
      auto file = policy::testing::make_mlp({.observation_size = rig.task->observation().size(),
                                             .hidden = {32},
                                             .axes = rig.task->spec().action_axes,
                                             .horizon = Rig::kHorizon,
                                             .version = version});
      file.metadata["task"] = "peg";
      file.metadata["observation"] = nlohmann::json(rig.task->observation().names()).dump();
      slot.publish(load_policy(policy::testing::write_file(file), "", *rig.task, Rig::kHorizon));
    });
    loader.join();
  };
  publish(1);
  PolicyWorker worker(*rig.task, slot);
  Random random{1};
  ImpedanceGains soft = rig.control.gains;
  soft.stiffness *= 0.5;
  int64_t allocated = 0;
  int swaps = 0;
  for (int step = 0; step < 1000; ++step) {
    if (step % 100 == 99) publish(2 + swaps++);
    const testing::AllocationCounter allocations;
    // Inference by the policy's thread, new chunks, hand-overs, new gains, contact with the block.
    const StepSnapshot snapshot = rig.begin_step();
    ASSERT_TRUE(worker.ask(snapshot));
    while (!worker.answer()) worker.answered().wait_for(std::chrono::milliseconds(100));
    if (worker.answer()->has_chunk) rig.loop.accept(worker.answer()->chunk);
    worker.pop_answer();
    Twist twist = Twist::Constant(random.uniform(-1, 1));
    twist[2] -= 0.2;
    rig.hear(twist, step % 7 < 2);
    if (step % 31 == 0) rig.loop.set_gains(step % 2 ? soft : rig.control.gains, rig.now_us);
    rig.run_step();
    allocated += allocations.count();
  }
  EXPECT_EQ(allocated, 0);
  EXPECT_EQ(rig.loop.ticks(), 100'000);
  EXPECT_GE(rig.loop.executor().policy_version(), swaps);
  EXPECT_EQ(rig.loop.fault(), Fault::none);
}

TEST(ControlLoop, ArmStandsStillWhenNobodyDrives) {
  Rig rig;
  rig.begin(2, Phase::demonstration);
  rig.begin_step();
  rig.hear(Twist::Zero(), false);
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
    if (snapshot.chunk_id >= 0) rig.loop.accept(rig.constant_chunk(snapshot.chunk_id, step, asked));
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
    rig.hear(Twist::Ones(), true);
    const StepRecord record = rig.run_step();
    EXPECT_EQ(record.executed[3], 0.0);
    EXPECT_EQ(record.executed[4], 0.0);
    EXPECT_EQ(record.human[3], 0.0);
  }
}

TEST(ControlLoop, HandIsToldToBeOpenOrClosedAndNothingBetween) {
  Rig rig({.mode = ExecutionMode::receding, .horizon = Rig::kHorizon, .execute = 1}, "square");
  rig.begin(3);
  int step = 0;
  const auto told = [&rig, &step](double gripper) {
    const StepSnapshot snapshot = rig.begin_step();
    Action asked = Action::Zero();
    asked[6] = gripper;
    rig.loop.accept(rig.constant_chunk(snapshot.chunk_id, step++, asked));
    return rig.run_step().executed[6];
  };
  EXPECT_EQ(told(-0.8), -1.0);
  EXPECT_EQ(told(0.2), -1.0) << "not decided: as it was told last";
  EXPECT_EQ(told(0.4), 1.0);
  EXPECT_EQ(told(-0.2), 1.0);
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
    rig.hear(down, true);
    const StepRecord record = rig.run_step();
    if (step > 50) force = std::max(force, record.force_filtered_peak);
  }
  const double bound = rig.control.gains.stiffness(2, 2) * rig.control.gains.clip_low[2];
  EXPECT_GT(force, 0.5 * bound);         // it does press
  EXPECT_LT(force, 1.05 * bound + 0.5);  // and never harder than it says
  // The commanded pose does not wind up while the arm is blocked.
  EXPECT_LE(std::abs(minus(rig.loop.commanded_pose(), rig.loop.arm().X_WE)[2]),
            rig.control.gains.clip_low[2] + 1e-3);
}

TEST(ControlLoop, ThousandsOfHandOversJumpNeitherPoseNorTorque) {
  Rig rig;
  Random random{8};
  int hand_overs = 0;
  for (int episode = 0; episode < 60; ++episode) {
    rig.begin(100 + episode, episode % 2 ? Phase::training : Phase::evaluation);
    bool engaged = false;
    int id = 0;
    Pose commanded = rig.loop.arm().X_WE, reference = commanded;
    JointVector tau = JointVector::Zero();
    for (int step = 0; step < 20; ++step) {
      rig.begin_step();
      // A chunk comes at a random phase of the step, some of them late, some not at all.
      Action action = Action::Zero();
      for (int i = 0; i < 6; ++i) action[i] = random.uniform(-1, 1);
      const Chunk chunk = rig.constant_chunk(id++, step, action);
      const int arrival = static_cast<int>(random.uniform(0, 140));
      for (int tick = 0; tick < 100; ++tick) {
        if (tick == arrival) rig.loop.accept(chunk);
        if (random.uniform(0, 1) < 0.03) {
          engaged = !engaged;
          ++hand_overs;
          Twist twist;
          for (int i = 0; i < 6; ++i) twist[i] = random.uniform(-1, 1);
          rig.hear(twist, engaged);
        }
        rig.tick();
        const TickRecord record = rig.latest_tick();
        for (const Twist& jump : {minus(record.X_WE_reference, reference),
                                  minus(rig.loop.commanded_pose(), commanded)}) {
          ASSERT_LE(jump.head<3>().norm(), 0.0005);
          ASSERT_LE(jump.tail<3>().norm(), 0.005);
        }
        ASSERT_LE((record.tau_commanded - tau).cwiseAbs().maxCoeff(), 1.0);
        reference = record.X_WE_reference;
        commanded = rig.loop.commanded_pose();
        tau = record.tau_commanded;
      }
      rig.loop.end_step();
      rig.drain();
    }
    EXPECT_EQ(rig.robot.state().fault, Fault::none);
  }
  EXPECT_GT(hand_overs, 3000);
}

TEST(ControlLoop, HandBackHoldsUntilAChunkThatWasSeenAfterIt) {
  Rig rig({.mode = ExecutionMode::receding, .horizon = Rig::kHorizon});
  rig.begin(9);
  Action asked = Action::Zero();
  asked[0] = 1.0;
  rig.begin_step();
  rig.loop.accept(rig.constant_chunk(0, 0, asked));
  rig.hear(Twist::Zero(), true);
  rig.run_step();
  rig.begin_step();
  for (int tick = 0; tick < 50; ++tick) rig.tick();
  rig.hear(Twist::Zero(), false);
  rig.tick();
  // Seen at the step's start, when the human still had the arm.
  Chunk seen_before = rig.constant_chunk(1, 1, asked);
  rig.loop.accept(seen_before);
  EXPECT_FALSE(rig.loop.executor().due(1));
  EXPECT_EQ(rig.loop.executor().counts().refused[3], 1);  // stale
  seen_before.id = 2;
  seen_before.observation_tick = 150;
  rig.loop.accept(seen_before);
  EXPECT_TRUE(rig.loop.executor().due(1));
}

TEST(ControlLoop, HumanStepIsMarkedAndHisActionKeptBesideThePolicys) {
  Rig rig;
  rig.begin(6);
  StepSnapshot snapshot = rig.begin_step();
  Action asked = Action::Zero();
  asked[0] = 0.5;
  rig.loop.accept(rig.constant_chunk(snapshot.chunk_id, 0, asked));
  StepRecord record = rig.run_step();
  EXPECT_FALSE(record.intervention);
  rig.begin_step();
  Twist twist = Twist::Zero();
  twist[1] = 0.5;
  rig.hear(twist, true);
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

TEST(ControlLoop, VerdictOfTheHumanStaysAndCountsForItsEpisodeOnly) {
  Rig rig;
  rig.begin(10);
  HumanCommand command = Rig::human(Twist::Zero(), false);
  command.label = 2;
  command.episode_answered = 7;  // another one
  rig.loop.hear(command, 0);
  EXPECT_EQ(rig.loop.label(), 0);
  command.episode_answered = 0;
  rig.loop.hear(command, 0);
  command.label = 0;
  rig.loop.hear(command, 0);  // the next message, 20 ms later
  EXPECT_EQ(rig.loop.label(), 2);
  rig.begin(11);
  EXPECT_EQ(rig.loop.label(), 0);
}

TEST(ControlLoop, ModelledLatencyDelaysTheTakeOver) {
  Rig rig({.mode = ExecutionMode::receding, .horizon = Rig::kHorizon, .latency_ticks = 30});
  rig.begin(12);
  rig.begin_step();
  Action asked = Action::Zero();
  asked[0] = 1.0;
  rig.loop.accept(rig.constant_chunk(0, 0, asked));
  for (int tick = 0; tick < 30; ++tick) rig.tick();
  EXPECT_FALSE(rig.loop.executor().due(0));
  rig.tick();
  EXPECT_TRUE(rig.loop.executor().due(0));
  EXPECT_EQ(rig.loop.executor().latency_ticks(), 30);
  for (int tick = 31; tick < 100; ++tick) rig.tick();
  EXPECT_NEAR(rig.loop.end_step().executed[0], 0.7, 1e-9);
}

TEST(ControlLoop, NewGainsRampInAndTheBoundFollows) {
  Rig rig;
  rig.begin(13);
  rig.begin_step();
  rig.drain();
  ImpedanceGains soft = rig.control.gains;
  soft.stiffness *= 0.25;
  rig.loop.set_gains(soft, rig.now_us);
  ASSERT_TRUE(std::holds_alternative<GainsRecord>(*rig.records.front()));
  double bound = 20.0;
  JointVector tau = JointVector::Zero();
  for (int tick = 0; tick < CartesianImpedance::kRampTicks + 1; ++tick) {
    rig.tick();
    const TickRecord record = rig.latest_tick();
    ASSERT_LE((record.tau_commanded - tau).cwiseAbs().maxCoeff(), 1.0);
    ASSERT_LE(record.force_bound[0], bound + 1e-9);
    bound = record.force_bound[0];
    tau = record.tau_commanded;
  }
  EXPECT_NEAR(bound, 5.0, 1e-9);
}

}  // namespace
}  // namespace tandem
