#include <gtest/gtest.h>

#include <cmath>

#include "tracking_run.h"

namespace tandem::bench {
namespace {

const std::string kController = std::string(TANDEM_ROOT) + "/config/controller.yaml";

TEST(TrackingPath, CommandsStayWithinTheActionLimitsAndPlayThePath) {
  Pose commanded = path_start();
  const std::vector<Action> actions = path_actions();
  for (int step = 0; step < kSteps; ++step) {
    ASSERT_LE(minus(path(0.1 * step), commanded).norm(), 1e-9);
    ASSERT_LE(actions[step].cwiseAbs().maxCoeff(), 1.0);
    commanded = add(commanded, actions[step].head<6>().cwiseProduct(action_limit()));
  }
  EXPECT_LE(minus(path_start(), commanded).norm(), 1e-9);
}

TEST(Tracking, DefaultSettingsFollowThePathAndTheOtherDesignsDoWorse) {
  const TrackingSettings settings = read_tracking(Section::load(kController));
  const Tracking ours = follow_path(Variant::ours, settings, 2.0, TANDEM_MODELS);
  EXPECT_LT(ours.position_rms, 0.004);
  EXPECT_LT(ours.rotation_rms, 0.016);
  EXPECT_LT(ours.delayed_position_rms, 0.0015);
  // A spring of 2000 N/m and 150 N m/rad gives way by so much, and no more.
  EXPECT_NEAR(ours.position_steady, 2.0 / 2000.0, 1e-4);
  EXPECT_NEAR(ours.rotation_steady, kLever * 2.0 / 150.0, 1e-4);

  const Tracking half = follow_path(Variant::half_rotation, settings, 2.0, TANDEM_MODELS);
  EXPECT_NEAR(half.rotation_steady, 2.0 * ours.rotation_steady, 1e-4);
  const Tracking sagging = follow_path(Variant::measured_anchor, settings, 2.0, TANDEM_MODELS);
  EXPECT_GT(sagging.position_steady, 100 * ours.position_steady);
}

}  // namespace
}  // namespace tandem::bench
