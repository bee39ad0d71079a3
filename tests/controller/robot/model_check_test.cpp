#include "controller/robot/model_check.h"

#include <gtest/gtest.h>

#include "controller/robot/scenes.h"

namespace tandem {
namespace {

using namespace testing;

std::string refusal(const Simulation& simulation, ArmModel& arm) {
  try {
    check_model(simulation, arm);
  } catch (const std::exception& error) {
    return error.what();
  }
  return "accepted";
}

TEST(ModelCheck, UrdfAndSimulatorAgreeToRoundingInEveryScene) {
  for (const std::string& scene : {kArmScene, kPegScene}) {
    Simulation simulation(scene);
    ArmModel arm(kUrdf);
    arm.set_load(simulation.held_load());
    const ModelErrors errors = check_model(simulation, arm);
    for (const double error :
         {errors.pose, errors.jacobian, errors.mass, errors.gravity, errors.coriolis}) {
      EXPECT_LT(error, 1e-12) << scene;
      EXPECT_GT(error, 0.0) << scene << ": two programs that agree exactly were not compared";
    }
  }
}

TEST(ModelCheck, LeavesTheSimulationAlone) {
  Simulation simulation(kPegScene);
  ArmModel arm(kUrdf);
  arm.set_load(simulation.held_load());
  simulation.set_arm(home(), 0.03);
  simulation.step(JointVector::Constant(0.5), Eigen::Vector2d::Zero());
  const JointVector q = simulation.q(), dq = simulation.dq();
  check_model(simulation, arm);
  EXPECT_EQ(simulation.q(), q);
  EXPECT_EQ(simulation.dq(), dq);
}

TEST(ModelCheck, RefusesAForgottenLoadAndNamesIt) {
  Simulation simulation(kPegScene);
  ArmModel arm(kUrdf);
  const std::string text = refusal(simulation, arm);
  EXPECT_NE(text.find("mass matrix"), std::string::npos) << text;
  EXPECT_NE(text.find("set_load"), std::string::npos) << text;
}

TEST(ModelCheck, RefusesALinkThatIsAThousandthHeavier) {
  Simulation simulation(kArmScene);
  ArmModel arm(kUrdf);
  simulation.model()->body_mass[simulation.body("link4")] *= 1.001;
  EXPECT_NE(refusal(simulation, arm).find("mass matrix ["), std::string::npos);
}

TEST(ModelCheck, RefusesALinkThatIsAHundredthOfAMillimetreLonger) {
  Simulation simulation(kArmScene);
  ArmModel arm(kUrdf);
  simulation.model()->body_pos[3 * simulation.body("link5") + 1] += 1e-5;
  EXPECT_NE(refusal(simulation, arm).find("tool position p_WE ["), std::string::npos);
}

TEST(ModelCheck, RefusesAForgottenRotorInertia) {
  Simulation simulation(kArmScene);
  ArmModel arm(kUrdf, 0.02, 0.0);
  const std::string text = refusal(simulation, arm);
  EXPECT_NE(text.find("mass matrix ["), std::string::npos) << text;
  EXPECT_NE(text.find("armature"), std::string::npos) << text;
}

}  // namespace
}  // namespace tandem
