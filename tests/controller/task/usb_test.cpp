#include "controller/task/usb.h"

#include <gtest/gtest.h>

#include <fstream>
#include <set>

#include "controller/rig.h"
#include "controller/robot/leds.h"

namespace tandem {
namespace {

using testing::config;
using testing::Rig;

constexpr double kOpen = -1.0, kClosed = 1.0;

Pose shifted(double x, double y, double z) { return {{x, y, z}, Eigen::Quaterniond::Identity()}; }

Pose turned(double yaw) {
  return {Eigen::Vector3d::Zero(),
          Eigen::Quaterniond(Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()))};
}

/// The plug in the hand of the real arm, under the real law, over the panel.
class Usb : public ::testing::Test {
 protected:
  SceneTruth truth() const { return rig.task->truth(rig.simulation); }
  Pose X_GO() const { return inverse(truth().X_WG) * truth().X_WO; }
  double depth() const { return -X_GO().p.z(); }
  /// m, how far the plug has left the place in the hand where a perfect grasp holds it.
  double slip() const { return (truth().X_WH.p - rig.simulation.tool_pose().p).norm(); }

  /// One policy step of the human: `twist` m or rad of the commanded pose.
  void move(const Twist& delta, double gripper) {
    HumanCommand command = Rig::human(delta.cwiseQuotient(limit_or_one()), true);
    command.gripper = gripper;
    rig.loop.hear(command, rig.now_us);
    rig.begin_step();
    rig.run_step();
  }
  void stay(int steps, double gripper) {
    for (int i = 0; i < steps; ++i) move(Twist::Zero(), gripper);
  }
  void lower(double metres_per_step, int steps, double gripper = kClosed) {
    Twist delta = Twist::Zero();
    delta[2] = -metres_per_step;
    for (int i = 0; i < steps; ++i) move(delta, gripper);
  }

  /// Puts the plug `height` over `X_WT` (z out of it), turned by `yaw` about it, and the arm around
  /// it with the fingers closed.
  void hold_over(const Pose& X_WT, double yaw, double height = 0.002) {
    const Pose X_TO = shifted(0.0, 0.0, height) * pointing_down(Eigen::Vector3d::Zero());
    place_arm(rig.robot, rig.model, X_WT * X_TO * inverse(rig.task->spec().X_HO), 0.0138);
    rig.simulation.place_free_body(rig.simulation.body("plug"), X_WT * turned(yaw) * X_TO);
    rig.simulation.forward();
    begin_episode();
    stay(3, kClosed);
    ASSERT_LT(slip(), 0.0005);
  }

  /// An episode whose arm is over the plug, ready to take it.
  void begin_over_plug(uint64_t seed) {
    rig.begin(seed, Phase::demonstration);
    place_arm(rig.robot, rig.model, truth().X_WH, kGripperStroke);
    rig.simulation.place_free_body(rig.simulation.body("plug"),
                                   rig.simulation.site_pose(rig.simulation.site("seat")));
    rig.simulation.forward();
    begin_episode();
  }

  void begin_episode() {
    rig.robot.recover();
    rig.loop.begin_episode({.episode = 0, .episode_seed = 1, .phase = Phase::demonstration});
  }

  /// Down with all that the law gives (20 N) and a hand that leans on it with 15 N.
  void press_with_35_newtons() {
    lower(0.006, 10);
    rig.robot.push({0.0, 0.0, -15.0}, 500);
    lower(0.006, 5);
  }

  /// Pulls at the plug, upwards, for half a second.
  void pull(double newtons) {
    double* force = rig.simulation.data()->xfrc_applied + 6 * rig.simulation.body("plug");
    force[2] = newtons;
    stay(5, kOpen);
    force[2] = 0.0;
  }

  Twist limit_or_one() const {
    const Twist& limit = rig.task->spec().action_limit;
    return (limit.array() > 0.0).select(limit, 1.0);
  }

  Rig rig{{.mode = ExecutionMode::open_loop, .horizon = Rig::kHorizon, .execute = Rig::kHorizon},
          "usb"};
};

//------------------------------ port ------------------------------

TEST_F(Usb, GoesInWithTheForceOfItsSpringsAndStaysUntilItIsPulledOut) {
  rig.begin(3, Phase::demonstration);
  hold_over(truth().X_WG, 0.0);
  double force = 0.0;
  for (int i = 0; i < 30; ++i) {
    lower(0.001, 1);
    if (depth() < 0.0085) force = std::max(force, rig.begin_step().F_ext_W[2]);
  }
  EXPECT_GT(force, 5.0) << "the springs resist";
  EXPECT_LT(force, 15.0);
  EXPECT_GT(depth(), 0.0075);
  EXPECT_LT(X_GO().p.head<2>().norm(), 0.0003);

  stay(10, kOpen);  // fingers off
  pull(3.0);
  EXPECT_GT(depth(), 0.0075);
  pull(12.0);
  EXPECT_LT(depth(), 0.0);
}

TEST_F(Usb, GoesInAtEveryPort) {
  std::set<std::string> met;
  for (uint64_t seed = 0; met.size() < 4 && seed < 30; ++seed) {
    rig.begin(seed, Phase::demonstration);
    std::string wanted;
    for (const char* name : {"usb1", "usb2", "usb3", "usb4"}) {
      if (rig.simulation.placed_body(rig.simulation.body(name)).p.z() < 0.0) wanted += name;
    }
    ASSERT_EQ(wanted.size(), 4u) << "exactly one port is open: " << wanted;
    if (!met.insert(wanted).second) continue;
    hold_over(truth().X_WG, 0.0);
    lower(0.004, 6);
    EXPECT_GT(depth(), 0.0075) << wanted;
  }
  EXPECT_EQ(met.size(), 4u);
}

TEST_F(Usb, UpsideDownStopsAtTheTongue) {
  rig.begin(3, Phase::demonstration);
  hold_over(truth().X_WG, M_PI);
  press_with_35_newtons();
  EXPECT_GT(depth(), 0.0005) << "it enters the mouth";
  EXPECT_LT(depth(), 0.003);
}

TEST_F(Usb, EntersNeitherAClosedPortNorThePanel) {
  rig.begin(3, Phase::demonstration);
  const Simulation& s = rig.simulation;
  int closed = s.body("usb1");
  if (s.placed_body(closed).p.z() < 0.0) closed = s.body("usb2");
  const Pose beside = s.body_pose(s.body("panel")) * shifted(0.040, -0.003, 0.0);
  for (const Pose& X_WT : {s.body_pose(closed), beside}) {
    hold_over(X_WT, 0.0);
    press_with_35_newtons();
    EXPECT_NEAR((inverse(X_WT) * truth().X_WO).p.z(), 0.0, 0.0003);
  }
}

//------------------------------ grasp ------------------------------

TEST_F(Usb, StandsStillUntilItIsTakenAndComesOutEasily) {
  begin_over_plug(5);
  const Pose X_WO = truth().X_WO;
  stay(5, kOpen);
  EXPECT_LT(minus(truth().X_WO, X_WO).norm(), 2e-4);
  stay(10, kClosed);
  lower(-0.006, 8);
  EXPECT_LT(slip(), 0.001);
  EXPECT_GT(truth().X_WO.p.z() - X_WO.p.z(), 0.035);
}

TEST_F(Usb, HeldBesideItsGraspItIsHeldAllTheSame) {
  begin_over_plug(6);
  Twist aside = Twist::Zero();
  aside.head<3>() << 0.003, 0.003, 0.004;
  move(aside, kOpen);
  stay(12, kClosed);
  lower(-0.006, 8);
  EXPECT_LT(slip(), 0.008);
  EXPECT_GT(truth().X_WO.p.z(), 0.08);
}

TEST_F(Usb, DroppedIntoItsStandItCanBeTakenAgain) {
  begin_over_plug(7);
  const double in_stand = truth().X_WO.p.z();
  stay(10, kClosed);
  lower(-0.004, 1);
  lower(-0.003, 1);
  ASSERT_GT(truth().X_WO.p.z(), in_stand + 0.005);
  stay(10, kOpen);  // it falls back
  EXPECT_NEAR(truth().X_WO.p.z(), in_stand, 0.001);
  lower(0.007, 1, kOpen);
  stay(2, kOpen);
  stay(10, kClosed);
  lower(-0.006, 8);
  EXPECT_GT(truth().X_WO.p.z(), in_stand + 0.035);
}

TEST_F(Usb, OpenFingersLoseItAndClosedOnNothingHoldNothing) {
  begin_over_plug(8);
  stay(10, kClosed);
  lower(-0.010, 6);
  ASSERT_LT(slip(), 0.002);
  stay(8, kOpen);
  EXPECT_GT(slip(), 0.02);
  EXPECT_LT(truth().X_WO.p.z(), 0.06);
  stay(12, kClosed);
  EXPECT_LT(rig.robot.state().gripper_width, 0.003);
}

//------------------------------ reset, success, looks ------------------------------

TEST_F(Usb, SameSeedGivesTheSameSceneWhateverWasBefore) {
  const auto scene = [&](uint64_t seed) {
    rig.begin(seed);
    std::vector<double> all;
    const mjModel* model = rig.simulation.model();
    const mjData* data = rig.simulation.data();
    all.insert(all.end(), data->qpos, data->qpos + model->nq);
    all.insert(all.end(), data->xpos, data->xpos + 3 * model->nbody);
    all.insert(all.end(), data->xquat, data->xquat + 4 * model->nbody);
    all.insert(all.end(), model->light_diffuse, model->light_diffuse + 3 * model->nlight);
    return all;
  };
  const std::vector<double> first = scene(11), other = scene(12);
  lower(0.01, 3);
  EXPECT_EQ(scene(11), first);
  EXPECT_NE(other, first);
}

TEST_F(Usb, ResetsStayWithinTheirDistribution) {
  double widest_panel = 0.0, widest_stand = 0.0;
  for (uint64_t seed = 0; seed < 60; ++seed) {
    rig.begin(seed);
    const Simulation& s = rig.simulation;
    const Pose X_WP = s.body_pose(s.body("panel")), X_WS = s.body_pose(s.body("stand"));
    const double panel = (X_WP.p - Eigen::Vector3d(0.52, 0.06, 0.10)).cwiseAbs().maxCoeff();
    const double stand = (X_WS.p - Eigen::Vector3d(0.50, -0.09, 0.05)).cwiseAbs().maxCoeff();
    ASSERT_LE(panel, 0.020 + 1e-9);
    ASSERT_LE(stand, 0.030 + 1e-9);
    ASSERT_LE(std::abs(log_map(X_WP.R).z()), 10.0 * M_PI / 180 + 1e-9);
    ASSERT_LE(std::abs(log_map(X_WS.R).z()), 20.0 * M_PI / 180 + 1e-9);
    ASSERT_FALSE(rig.task->succeeded(truth(), s));
    ASSERT_LT(s.contact_wrench().norm(), 1e-12) << "the hand touches nothing";
    widest_panel = std::max(widest_panel, panel);
    widest_stand = std::max(widest_stand, stand);
  }
  EXPECT_GT(widest_panel, 0.015);
  EXPECT_GT(widest_stand, 0.022);
}

TEST_F(Usb, SuccessAsksForDepthOnTheAxisForThreeStepsInARow) {
  rig.begin(1);
  const auto succeeded = [&](double x, double depth) {
    SceneTruth scene = truth();
    scene.X_WO = scene.X_WG * shifted(x, 0.0, -depth);
    return rig.task->succeeded(scene, rig.simulation);
  };
  EXPECT_FALSE(succeeded(0.0, 0.008));
  EXPECT_FALSE(succeeded(0.0, 0.008));
  EXPECT_TRUE(succeeded(0.0, 0.008));
  EXPECT_FALSE(succeeded(0.0004, 0.008)) << "off the axis";
  EXPECT_FALSE(succeeded(0.0, 0.008)) << "and counted from the start";
  EXPECT_FALSE(succeeded(0.0, 0.008));
  EXPECT_FALSE(succeeded(0.0, 0.007)) << "not deep enough";
  EXPECT_FALSE(succeeded(0.0, 0.008));
  EXPECT_FALSE(succeeded(0.0, 0.008));
  rig.begin(1);
  EXPECT_FALSE(succeeded(0.0, 0.008)) << "a new episode";
}

TEST_F(Usb, LightsVaryWithinTheirLimitsAndAreOnlyLooks) {
  mjModel* model = rig.simulation.model();
  const std::vector<double> lamp(model->light_diffuse, model->light_diffuse + 3);
  double dimmest = 1.0, brightest = 0.0, most_colour = 0.0;
  for (uint64_t seed = 0; seed < 200; ++seed) {
    light_leds(model, seed);
    for (int light = 1; light < model->nlight; ++light) {
      const Eigen::Vector3f rgb = Eigen::Vector3f::Map(model->light_diffuse + 3 * light);
      dimmest = std::min<double>(dimmest, rgb.maxCoeff());
      brightest = std::max<double>(brightest, rgb.maxCoeff());
      most_colour = std::max<double>(most_colour, 1.0 - rgb.minCoeff() / rgb.maxCoeff());
    }
  }
  EXPECT_EQ(lamp, std::vector<double>(model->light_diffuse, model->light_diffuse + 3));
  EXPECT_GE(dimmest, 0.25f);
  EXPECT_LT(dimmest, 0.3);
  EXPECT_LE(brightest, 0.9f);
  EXPECT_GT(brightest, 0.85);
  EXPECT_LE(most_colour, 0.5 + 1e-6);
  EXPECT_GT(most_colour, 0.4);
}

TEST(UsbTask, UnknownPortIsRefusedWithThoseThatThereAre) {
  const std::string file = std::string(TANDEM_ROOT) + "/config/tasks/usb.yaml";
  std::ifstream in(file);
  std::string text((std::istreambuf_iterator<char>(in)), {});
  const std::string key = "ports: [usb1, usb2, usb3, usb4]";
  ASSERT_NE(text.find(key), std::string::npos);
  text.replace(text.find(key), key.size(), "ports: [usb1, hdmi]");
  try {
    make_task(Section::parse(text, "usb.yaml"));
    FAIL();
  } catch (const ScenarioError& error) {
    EXPECT_NE(std::string(error.what()).find("'hdmi'; the panel has usb1, usb2, usb3 and usb4."),
              std::string::npos)
        << error.what();
  }
}

}  // namespace
}  // namespace tandem
