#include "controller/robot/simulation.h"

#include <gtest/gtest.h>

#include <functional>

#include "controller/robot/hole.h"
#include "controller/robot/scenes.h"
#include "support/allocation_counter.h"

namespace tandem {
namespace {

using namespace testing;

std::string message_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const std::exception& error) {
    return error.what();
  }
  return "nothing was thrown";
}

TEST(Simulation, GravityIsCompensatedSoThatTheArmStaysWhereItRests) {
  for (const std::string& scene : {kArmScene, kPegScene}) {
    Simulation simulation(scene);
    simulation.set_arm(home(), kPegWidth);
    for (int i = 0; i < 2000; ++i) simulation.step(JointVector::Zero(), Eigen::Vector2d::Zero());
    EXPECT_LT((simulation.q() - home()).cwiseAbs().maxCoeff(), 1e-9) << scene;
    EXPECT_NEAR(simulation.finger_position().sum(), kPegWidth, 1e-9) << scene;
  }
}

TEST(Simulation, PosesAfterAStepBelongToTheNewState) {
  Simulation simulation(kPegScene);
  ArmModel arm(kUrdf);
  ArmState state;
  simulation.set_arm(home(), kPegWidth);
  for (int i = 0; i < 200; ++i)
    simulation.step(JointVector::Constant(2.0), Eigen::Vector2d::Zero());
  arm.update(simulation.q(), simulation.dq(), state);
  EXPECT_GT(simulation.dq().norm(), 0.1);
  EXPECT_LT(minus(simulation.tool_pose(), state.X_WE).norm(), 1e-12);
}

TEST(Simulation, ContactWrenchAndExternalTorqueTellTheSameForce) {
  Simulation simulation(kPegScene);
  ArmModel arm(kUrdf);
  ArmState before;
  const Pose rim = simulation.site_pose(simulation.site("goal"));
  simulation.set_arm(arm.solve_ik(tool_over(rim.p + Eigen::Vector3d(0.006, 0.004, 0.0005)), home()),
                     kPegWidth);
  double largest = 0;
  for (int i = 0; i < 400; ++i) {
    arm.update(simulation.q(), simulation.dq(), before);
    const JointVector push =
        before.J.transpose() * (Wrench() << 2, 1, -20, 0, 0, 0).finished() - 8 * simulation.dq();
    simulation.step(push, Eigen::Vector2d::Zero());
    const JointVector expected = before.J.transpose() * simulation.contact_wrench();
    EXPECT_LT((expected - simulation.external_torque()).cwiseAbs().maxCoeff(), 1e-9);
    largest = std::max(largest, simulation.contact_wrench()[2]);
  }
  EXPECT_GT(largest, 10.0) << "the test must have touched the block";
}

TEST(Simulation, PegSinksLessThanFiveHundredthsOfAMillimetreAtTwentyNewton) {
  Simulation simulation(kPegScene);
  ArmModel arm(kUrdf);
  ArmState state;
  const Pose rim = simulation.site_pose(simulation.site("goal"));
  const JointVector q = arm.solve_ik(tool_over(rim.p + Eigen::Vector3d(0.02, 0.0, 0.0)), home());
  simulation.set_arm(q, kPegWidth);
  for (int i = 0; i < 1500; ++i) {
    arm.update(simulation.q(), simulation.dq(), state);
    const Twist error = minus(tool_over(rim.p + Eigen::Vector3d(0.02, 0.0, 0.0)), state.X_WE);
    Wrench F = 2000 * error - 80 * state.V_WE;
    F.tail<3>() = 150 * error.tail<3>() - 7 * state.V_WE.tail<3>();
    F[2] = -20.0 - 80 * state.V_WE[2];
    simulation.step(state.J.transpose() * F + state.coriolis - 2 * simulation.dq(),
                    Eigen::Vector2d::Zero());
  }
  EXPECT_NEAR(simulation.contact_wrench()[2], 20.0, 0.1);
  const double tip = simulation.site_pose(simulation.site("object")).p.z();
  EXPECT_LT(rim.p.z() - tip, 5e-5);
  EXPECT_GT(rim.p.z() - tip, 0.0);
}

TEST(Simulation, ResetAfterContactRepeatsTheSameMotionBitForBit) {
  Simulation simulation(kPegScene);
  ArmModel arm(kUrdf);
  const Pose rim = simulation.site_pose(simulation.site("goal"));
  const JointVector start =
      arm.solve_ik(tool_over(rim.p + Eigen::Vector3d(0.004, 0.002, 0.002)), home());
  const auto run = [&] {
    simulation.set_arm(start, kPegWidth);
    ArmState state;
    for (int i = 0; i < 300; ++i) {
      arm.update(simulation.q(), simulation.dq(), state);
      simulation.step(state.J.transpose() * (Wrench() << 3, 0, -15, 0, 0, 0).finished(),
                      Eigen::Vector2d::Zero());
    }
    return simulation.q();
  };
  const JointVector first = run();
  EXPECT_EQ(first, run());
}

TEST(Simulation, MovedHeldObjectAndFixtureAreWhereTheyWerePut) {
  Simulation simulation(kPegScene);
  const Pose X_EO{Eigen::Vector3d(0.001, -0.002, 0.003),
                  exp_map(Eigen::Vector3d(0.01, 0.02, -0.03))};
  const Pose X_WG{Eigen::Vector3d(0.45, 0.1, 0.05), exp_map(Eigen::Vector3d(0, 0, 0.4))};
  simulation.place_body(simulation.body("peg"), simulation.hand_to_tool() * X_EO);
  simulation.place_body(simulation.body("hole"), X_WG);
  simulation.set_arm(home(), kPegWidth);
  EXPECT_LT(
      minus(simulation.tool_pose() * X_EO, simulation.body_pose(simulation.body("peg"))).norm(),
      1e-12);
  EXPECT_LT(minus(X_WG, simulation.site_pose(simulation.site("goal"))).norm(), 1e-12);
}

TEST(Simulation, HeldLoadIsThePegAndNothingElse) {
  Simulation peg(kPegScene), bare(kArmScene);
  EXPECT_EQ(bare.held_load().mass, 0.0);
  const Load load = peg.held_load();
  EXPECT_NEAR(load.mass, 0.02 * 0.02 * 0.08 * 1200, 1e-12);
  EXPECT_LT((load.com_E - Eigen::Vector3d(0, 0, 0.02)).norm(), 1e-12);
  EXPECT_NEAR(load.inertia_E(2, 2), load.mass * (0.02 * 0.02 + 0.02 * 0.02) / 12, 1e-12);
}

TEST(Simulation, StepAllocatesNothing) {
  Simulation simulation(kPegScene);
  ArmModel arm(kUrdf);
  const Pose rim = simulation.site_pose(simulation.site("goal"));
  simulation.set_arm(arm.solve_ik(tool_over(rim.p + Eigen::Vector3d(0.002, 0, -0.0001)), home()),
                     kPegWidth);
  ASSERT_GT(simulation.data()->ncon, 0);
  AllocationCounter allocations;
  for (int i = 0; i < 50; ++i) simulation.step(JointVector::Constant(0.5), Eigen::Vector2d(1, 1));
  simulation.place_body(1, Pose{});
  simulation.set_arm(home(), 0.04);
  EXPECT_EQ(allocations.count(), 0);
}

TEST(Simulation, ErrorsAreSentencesThatNameFileAndRemedy) {
  Simulation simulation(kArmScene);
  EXPECT_EQ(message_of([&] { simulation.site("object"); }),
            kArmScene + ": the scene has no site named `object`; it has: tool.");
  EXPECT_NE(message_of([] { Simulation missing("no/such/scene.xml"); }).find("no/such/scene.xml"),
            std::string::npos);
}

TEST(Hole, HelperAndSceneFileAgreeOnTheDefaultClearance) {
  Simulation written(kPegScene), helped(kPegScene);
  EXPECT_NEAR(hole_clearance(written), 5e-4, 1e-12);
  set_hole_clearance(helped, 5e-4);
  const mjModel *a = written.model(), *b = helped.model();
  for (int i = 0; i < 3 * a->ngeom; ++i) {
    EXPECT_NEAR(a->geom_pos[i], b->geom_pos[i], 1e-12) << mj_id2name(a, mjOBJ_GEOM, i / 3);
    EXPECT_NEAR(a->geom_size[i], b->geom_size[i], 1e-12) << mj_id2name(a, mjOBJ_GEOM, i / 3);
  }
  for (int i = 0; i < a->ngeom; ++i) EXPECT_NEAR(a->geom_rbound[i], b->geom_rbound[i], 1e-12);
}

// Contacts when the peg's tip is at p_GT, straight.
int contacts(Simulation& simulation, ArmModel& arm, const Eigen::Vector3d& p_GT) {
  const Pose rim = simulation.site_pose(simulation.site("goal"));
  simulation.set_arm(arm.solve_ik(tool_over(rim.p + p_GT), home()), kPegWidth);
  return simulation.data()->ncon;
}

TEST(Hole, PegFitsWithinTheClearanceAndNotBeyond) {
  Simulation simulation(kPegScene);
  ArmModel arm(kUrdf);
  for (const double clearance : {5e-4, 2e-4}) {
    set_hole_clearance(simulation, clearance);
    for (const Eigen::Vector3d& side : {Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(-1, 0, 0),
                                        Eigen::Vector3d(0, 1, 0), Eigen::Vector3d(0, -1, 0)}) {
      const Eigen::Vector3d deep(0, 0, -0.02), shallow(0, 0, -0.0005), above(0, 0, 1e-5),
          under(0, 0, -1e-5);
      EXPECT_EQ(contacts(simulation, arm, deep), 0);
      EXPECT_EQ(contacts(simulation, arm, deep + (clearance - 1e-5) * side), 0);
      EXPECT_GT(contacts(simulation, arm, deep + (clearance + 1e-5) * side), 0);
      // Half way down the chamfer there is half its width of room.
      EXPECT_EQ(contacts(simulation, arm, shallow + (clearance + 4.9e-4) * side), 0);
      EXPECT_GT(contacts(simulation, arm, shallow + (clearance + 5.1e-4) * side), 0);
      // Beyond the chamfer the peg stands on the block.
      EXPECT_EQ(contacts(simulation, arm, above + (clearance + 1.2e-3) * side), 0);
      EXPECT_GT(contacts(simulation, arm, under + (clearance + 1.2e-3) * side), 0);
    }
    EXPECT_EQ(contacts(simulation, arm, Eigen::Vector3d(0, 0, -0.03 + 1e-5)), 0);
    EXPECT_GT(contacts(simulation, arm, Eigen::Vector3d(0, 0, -0.03 - 1e-5)), 0);
  }
}

TEST(Hole, ClearanceOutOfRangeIsRefusedWithValueAndRange) {
  Simulation simulation(kPegScene);
  EXPECT_EQ(message_of([&] { set_hole_clearance(simulation, 0.0); }),
            "The hole's clearance is 0.000000 mm a side; it must be in [0.05, 2] mm. The default "
            "is 0.5, the hard task 0.2.");
}

}  // namespace
}  // namespace tandem
