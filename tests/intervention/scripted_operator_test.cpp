#include "intervention/scripted_operator.h"

#include <gtest/gtest.h>

#include <cmath>

namespace tandem {
namespace {

OperatorRules rules() {
  return read_rules(Section::load(std::string(TANDEM_ROOT) + "/config/operator.yaml"));
}

/// The tip of the peg at `tip` above a hole at the origin, both upright.
world_state_t world_at(const Eigen::Vector3d& tip, int step, int8_t phase) {
  world_state_t w{};
  w.episode = 3;
  w.episode_seed = 99;
  w.step = step;
  w.tick = 100 * step;
  w.max_steps = 1000;
  w.phase = phase;
  w.q_WG[0] = 1.0;
  w.q_WO[1] = w.q_WE[1] = w.q_WE_commanded[1] = 1.0;  // turned about x: pointing down
  for (int i = 0; i < 3; ++i) w.p_WO[i] = w.p_WE[i] = w.p_WE_commanded[i] = tip[i];
  for (int i = 0; i < 6; ++i) w.action_limit[i] = i < 3 ? 0.012 : i == 5 ? 0.1 : 0.0;
  return w;
}

TEST(ScriptedOperator, RepeatedWorldGetsTheSameAnswer) {
  ScriptedOperator person(rules());
  const world_state_t world = world_at({0.03, 0.0, 0.05}, 0, world_state_t::DEMONSTRATION);
  const teleop_command_t first = person.answer(world), again = person.answer(world);
  for (int i = 0; i < 6; ++i) EXPECT_EQ(first.device_twist[i], again.device_twist[i]);
  EXPECT_EQ(again.tick_answered, world.tick);
}

TEST(ScriptedOperator, DemonstratesTowardsTheHoleAndLeavesMaskedAxesAlone) {
  ScriptedOperator person(rules());
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int step = 0; step < 30; ++step) {
    const teleop_command_t command =
        person.answer(world_at({0.03, -0.02, 0.05}, step, world_state_t::DEMONSTRATION));
    EXPECT_EQ(command.engaged, 1);
    EXPECT_EQ(command.device_twist[3], 0.0);
    sum += Eigen::Vector3d::Map(command.device_twist);
  }
  EXPECT_LT(sum.x(), -5.0);
  EXPECT_GT(sum.y(), 3.0);
  EXPECT_LT(sum.z(), -5.0);
}

TEST(ScriptedOperator, KeepsOffInEvaluation) {
  ScriptedOperator person(rules());
  for (int step = 0; step < 200; ++step) {
    EXPECT_EQ(person.answer(world_at({0.03, 0.0, 0.05}, step, world_state_t::EVALUATION)).engaged,
              0);
  }
}

TEST(ScriptedOperator, TakesOverWithoutProgressAndLetsGoAfterRecovery) {
  const OperatorRules r = rules();
  ScriptedOperator person(r);
  int taken_at = -1;
  for (int step = 0; step < 60 && taken_at < 0; ++step) {
    if (person.answer(world_at({0.05, 0.0, 0.05}, step, world_state_t::TRAINING)).engaged)
      taken_at = step;
  }
  EXPECT_GT(taken_at, r.no_progress_steps);
  EXPECT_LE(taken_at, r.no_progress_steps + r.reaction_steps_high + 3);
  int kept = 0;
  for (int step = taken_at + 1; step < taken_at + 60; ++step) {
    // He brings it half way.
    const double x = std::max(0.005, 0.05 - 0.004 * (step - taken_at));
    if (!person.answer(world_at({x, 0.0, x}, step, world_state_t::TRAINING)).engaged) break;
    ++kept;
  }
  EXPECT_GE(kept, r.hold_steps - 1);
  EXPECT_LT(kept, 30);
}

TEST(ScriptedOperator, TakesOverWhenTheArmPressesTooHard) {
  const OperatorRules r = rules();
  ScriptedOperator person(r);
  bool engaged = false;
  for (int step = 0; step < 15; ++step) {
    // Steady progress, so that only the force is a reason.
    world_state_t world = world_at({0.0, 0.0, 0.05 - 0.002 * step}, step, world_state_t::TRAINING);
    world.F_ext_W[2] = r.force + 5.0;
    engaged |= person.answer(world).engaged == 1;
  }
  EXPECT_TRUE(engaged);
}

TEST(ScriptedOperator, CallsAnEpisodeAFailureThatHeHasLongNotAdvanced) {
  const OperatorRules r = rules();
  ScriptedOperator person(r);
  int gave_up_at = -1;
  for (int step = 0; step < 200 && gave_up_at < 0; ++step) {
    // He gets nearer for 20 steps, then no further.
    const double height = 0.05 - 0.002 * std::min(step, 20);
    const world_state_t world = world_at({0.0, 0.0, height}, step, world_state_t::DEMONSTRATION);
    if (person.answer(world).label == teleop_command_t::LABEL_FAIL) gave_up_at = step;
  }
  EXPECT_EQ(gave_up_at, 20 + r.give_up_steps + 1);
}

/// An object in the fingers at `tip` above its goal, 60 mm deep; it lay 0.25 m beside it.
world_state_t carried_to(const Eigen::Vector3d& tip, int step) {
  const Eigen::Vector3d place = step == 0 ? Eigen::Vector3d(0.25, 0.0, -0.06) : tip;
  world_state_t w = world_at(place, step, world_state_t::TRAINING);
  for (int i = 0; i < 3; ++i) w.p_WH[i] = place[i];
  w.q_WH[1] = 1.0;
  w.goal_depth = 0.06;
  w.grasp_width = w.gripper_width = 0.03;
  return w;
}

TEST(ScriptedOperator, TakesOverBeforeTheObjectStrikesTheGoalFromBeside) {
  const OperatorRules r = rules();
  for (const double height : {0.5 * r.low_m, 2.0 * r.low_m}) {
    ScriptedOperator person(r);
    int engaged = 0;
    // Steady progress from 80 mm off the axis.
    for (int step = 0; step < 12; ++step)
      engaged += person.answer(carried_to({0.08 - 0.005 * step, 0.0, height}, step)).engaged;
    EXPECT_EQ(engaged > 0, height < r.low_m) << height;
  }
}

TEST(ScriptedOperator, TakesOverWhenTheObjectHangsAskewOverTheGoal) {
  const OperatorRules r = rules();
  for (const double tilt : {0.5 * r.askew_rad, 0.5 * (r.askew_rad + r.slip_rad)}) {
    ScriptedOperator person(r);
    int engaged = 0;
    for (int step = 0; step < 12; ++step) {
      world_state_t world = carried_to({0.0, 0.0, 0.06 - 0.003 * step}, step);
      if (step > 0) world.q_WO[1] = std::cos(0.5 * tilt), world.q_WO[3] = std::sin(0.5 * tilt);
      engaged += person.answer(world).engaged;
    }
    EXPECT_EQ(engaged > 0, tilt > r.askew_rad) << tilt;
  }
}

TEST(ScriptedOperator, PutsBackWhatSlippedInTheHandAndOpensOnlyThere) {
  const OperatorRules r = rules();
  ScriptedOperator person(r);
  Eigen::Vector3d away = Eigen::Vector3d::Zero();
  int opened = 0, engaged = 0;
  for (int step = 0; step < 40; ++step) {
    world_state_t world = carried_to({0.0, 0.0, 0.05}, step);
    if (step > 5) world.p_WH[0] += 1.2 * r.slip_m;  // the grasp is no longer where the hand is
    const teleop_command_t command = person.answer(world);
    engaged += command.engaged;
    if (step <= 5 || !command.engaged) continue;
    away += Eigen::Vector3d::Map(command.device_twist);
    opened += command.device_gripper < 0.0;
  }
  EXPECT_GT(engaged, 20);
  EXPECT_GT(away.x(), 1.0) << "to where it lay";
  EXPECT_EQ(opened, 0) << "it would fall on the goal";
}

TEST(ScriptedOperator, CallsAnEpisodeAFailureSoonWhenTheObjectHasToppled) {
  const OperatorRules r = rules();
  ScriptedOperator person(r);
  int gave_up_at = -1, engaged_at = -1;
  for (int step = 0; step < 200 && gave_up_at < 0; ++step) {
    world_state_t world = carried_to({0.25, 0.0, -0.06}, step);
    world.p_WE[2] += 0.1, world.p_WE_commanded[2] += 0.1;
    world.gripper_width = 0.08;
    if (step > 0) world.q_WO[0] = world.q_WO[1] = std::sqrt(0.5);  // on its side
    const teleop_command_t command = person.answer(world);
    if (command.engaged && engaged_at < 0) engaged_at = step;
    if (command.label == teleop_command_t::LABEL_FAIL) gave_up_at = step;
  }
  ASSERT_GE(engaged_at, 0);
  EXPECT_LE(gave_up_at, engaged_at + r.reaction_steps_high + 2);
  EXPECT_GT(gave_up_at, engaged_at);
}

TEST(ScriptedOperator, PressesOnWhereTheGoalIsSaidToResist) {
  const OperatorRules r = rules();
  for (const double resistance : {0.0, 10.0}) {
    ScriptedOperator person(r);
    double down = 0.0;
    for (int step = 0; step < 10; ++step) {
      world_state_t world = world_at({0.0, 0.0, -0.003}, step, world_state_t::DEMONSTRATION);
      world.goal_depth = 0.009;
      world.insertion_force = resistance;
      world.F_ext_W[2] = r.push_force + 5.0;
      down -= person.answer(world).device_twist[2];
    }
    EXPECT_EQ(down > 0.0, resistance > 5.0) << resistance << " N";
  }
}

}  // namespace
}  // namespace tandem
