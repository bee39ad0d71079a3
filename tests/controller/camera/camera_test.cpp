#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "base/sha256.h"
#include "controller/camera/camera_view.h"
#include "controller/camera/camera_worker.h"
#include "controller/episode/messages.h"
#include "controller/loop/policy_worker.h"
#include "controller/rig.h"
#include "support/allocation_counter.h"

namespace tandem {
namespace {

using testing::Rig;

CameraSettings settings(double jitter = 1.0) {
  CameraSettings settings = read_camera(testing::config("controller.yaml").section("camera"));
  settings.jitter.light *= jitter;
  settings.jitter.colour *= jitter;
  settings.jitter.position_m *= jitter;
  settings.jitter.angle_rad *= jitter;
  return settings;
}

SceneState state_of(Rig& rig, uint64_t seed) {
  SceneState state;
  state.episode_seed = seed;
  CameraView::capture(rig.simulation, state);
  return state;
}

double brightness(const CameraFrame& frame) {
  double sum = 0;
  for (const uint8_t value : frame.pixels) sum += value;
  return sum / static_cast<double>(frame.pixels.size());
}

TEST(CameraView, SameStateAndSeedGiveTheSameBytesWhateverWasDrawnBefore) {
  Rig rig;
  rig.begin(1);
  CameraView view(rig.simulation, settings());
  const SceneState one = state_of(rig, 1);
  const auto first = view.frame(one);
  rig.begin(2);
  const auto other = view.frame(state_of(rig, 2));
  EXPECT_NE(first->jpeg, other->jpeg) << "the hole stands elsewhere";
  EXPECT_EQ(view.frame(one)->jpeg, first->jpeg);
  EXPECT_EQ(CameraView(rig.simulation, settings()).frame(one)->jpeg, first->jpeg);
}

TEST(CameraView, PolicySeesThePixelsOfTheJpegThatIsLogged) {
  Rig rig;
  rig.begin(1);
  const auto frame = CameraView(rig.simulation, settings()).frame(state_of(rig, 1));
  cv::Mat rgb;
  cv::cvtColor(cv::imdecode(frame->jpeg, cv::IMREAD_COLOR), rgb, cv::COLOR_BGR2RGB);
  ASSERT_EQ(frame->pixels.size(), rgb.total() * 3);
  EXPECT_TRUE(std::equal(frame->pixels.begin(), frame->pixels.end(), rgb.data));
  double low = 255, high = 0;
  cv::minMaxIdx(rgb.reshape(1), &low, &high);
  EXPECT_GT(high - low, 60) << "an empty image passes every other test";
}

// tests/learner_py/test_images.py decodes the same file to the same digest: policy and learner see
// the same pixels.
TEST(CameraView, DecoderGivesThePixelsThatTheLearnersGives) {
  const cv::Mat bgr = cv::imread(TANDEM_ROOT "/tests/support/wrist.jpg", cv::IMREAD_COLOR);
  ASSERT_EQ(bgr.rows, 64);
  cv::Mat rgb;
  cv::cvtColor(bgr, rgb, cv::COLOR_BGR2RGB);
  Sha256 digest;
  digest.add(rgb.data, rgb.total() * 3);
  EXPECT_EQ(digest.hex(), "ad19b952f6007d182e74a9255b1643d6b0c3f6ca693870584459fe98809e83f1");
}

TEST(CameraView, JitterStaysInItsRangeAndWithoutItNothingMoves) {
  Rig rig;
  rig.begin(1);
  CameraView still(rig.simulation, settings(0.0)), shaken(rig.simulation, settings());
  const CameraSettings::Jitter limit = settings().jitter;
  const auto nominal = still.frame(state_of(rig, 1));
  double moved = 0, turned = 0, darkest = 255, brightest = 0;
  for (uint64_t seed = 2; seed < 60; ++seed) {
    const SceneState state = state_of(rig, seed);
    EXPECT_EQ(still.frame(state)->jpeg, nominal->jpeg);
    const auto frame = shaken.frame(state);
    for (size_t i = 0; i < frame->views.size(); ++i) {
      const Twist change = minus(frame->views[i].X_EC, nominal->views[i].X_EC);
      moved = std::max(moved, change.head<3>().cwiseAbs().maxCoeff());
      turned = std::max(turned, change.tail<3>().norm());
    }
    darkest = std::min(darkest, brightness(*frame));
    brightest = std::max(brightest, brightness(*frame));
  }
  // E's axes are the hand's, so the mount's change per axis shows in X_EC.
  EXPECT_LE(moved, limit.position_m + 1e-9);
  EXPECT_GT(moved, 0.9 * limit.position_m);
  EXPECT_LE(turned, std::sqrt(3.0) * limit.angle_rad + 1e-9);
  EXPECT_GT(turned, 0.9 * limit.angle_rad);
  const double share = limit.light + limit.colour + limit.light * limit.colour;
  EXPECT_GT(darkest, (1 - share) * (1 - limit.colour) * brightness(*nominal) - 3);
  EXPECT_LT(darkest, 0.95 * brightness(*nominal));
  EXPECT_GT(brightest, 1.03 * brightness(*nominal));
}

TEST(CameraView, LightsOfTheBoardChangeWithTheEpisode) {
  Rig rig({.mode = ExecutionMode::open_loop, .horizon = Rig::kHorizon, .execute = Rig::kHorizon},
          "usb");
  rig.begin(1);
  CameraView still(rig.simulation, settings(0.0));
  const SceneState one = state_of(rig, 1), other = state_of(rig, 2);  // the same scene
  const auto first = still.frame(one);
  EXPECT_NE(still.frame(other)->jpeg, first->jpeg);
  EXPECT_EQ(still.frame(one)->jpeg, first->jpeg);
}

TEST(CameraView, PoseAndFocalLengthSayWhereAThingIsInTheImage) {
  Rig rig;
  rig.begin(3);
  // Every geom black but one small box of green light, beside the peg; two cameras see it.
  mjModel* model = rig.simulation.model();
  for (int i = 0; i < model->nmat; ++i) std::fill_n(model->mat_rgba + 4 * i, 3, 0.0f);
  for (int i = 0; i < model->ngeom; ++i) std::fill_n(model->geom_rgba + 4 * i, 3, 0.0f);
  const int box = rig.simulation.geom("hole_wall_xp");
  model->geom_rgba[4 * box + 1] = 1.0f;
  Eigen::Vector3d::Map(model->geom_size + 3 * box).setConstant(0.002);
  model->geom_sameframe[box] = 0;
  for (const Eigen::Vector3d& offset : {Eigen::Vector3d(0.03, 0.02, 0.01), {0.05, -0.04, 0.0}}) {
    Eigen::Vector3d::Map(model->geom_pos + 3 * box) = offset;
    CameraSettings large = settings();
    large.width = large.height = 256;
    large.crop = offset.x() < 0.04 ? 0.8 : 1.0;
    CameraView view(rig.simulation, large);
    const auto frame = view.frame(state_of(rig, 3));
    rig.simulation.forward();
    const Eigen::Vector3d p_WB = Eigen::Vector3d::Map(rig.simulation.data()->geom_xpos + 3 * box);
    const camera_frame_t sent = to_message(*frame);
    ASSERT_EQ(sent.n_views, 2);
    ASSERT_EQ(sent.width, 2 * 256);
    for (int side = 0; side < 2; ++side) {
      const CameraFrame::View& eye = frame->views[static_cast<size_t>(side)];
      const Pose X_CW = inverse(rig.simulation.tool_pose() * eye.X_EC);
      const Eigen::Vector3d p_CB = X_CW.p + X_CW.R * p_WB;
      double u = 0, v = 0, sum = 0;
      for (int row = 0; row < 256; ++row) {
        for (int column = 256 * side; column < 256 * (side + 1); ++column) {
          const uint8_t* pixel = &frame->pixels[static_cast<size_t>(3 * (512 * row + column))];
          const double green = std::max(0, pixel[1] - std::max(pixel[0], pixel[2]) - 30);
          u += green * (column + 0.5);
          v += green * (row + 0.5);
          sum += green;
        }
      }
      ASSERT_GT(sum, 1000.0);
      const double focal_length = sent.focal_length[static_cast<size_t>(side)];
      const auto& center = sent.center[static_cast<size_t>(side)];
      EXPECT_NEAR(u / sum, focal_length * p_CB.x() / p_CB.z() + center[0], 1.5);
      EXPECT_NEAR(v / sum, focal_length * p_CB.y() / p_CB.z() + center[1], 1.5);
    }
  }
}

TEST(CameraView, UnknownCameraIsASentence) {
  Rig rig;
  CameraSettings other = settings();
  other.views = {"ceiling"};
  try {
    CameraView view(rig.simulation, other);
    FAIL();
  } catch (const std::runtime_error& error) {
    EXPECT_NE(std::string(error.what()).find("no camera named `ceiling`"), std::string::npos);
  }
}

TEST(CameraSettings, ImageOfNoViewIsASentence) {
  try {
    read_camera(Section::parse("{name: wrist, views: []}", "scenario.yaml"));
    FAIL();
  } catch (const ScenarioError& error) {
    EXPECT_NE(std::string(error.what()).find("views names 0 cameras; an image has 1 to 4 views."),
              std::string::npos)
        << error.what();
  }
}

TEST(CameraWorker, FailureToStartReachesTheCaller) {
  Rig rig;
  StatusBoard board;
  CameraSettings other = settings();
  other.views = {"ceiling"};
  EXPECT_THROW(CameraWorker(
                   rig.simulation, other, true, [](auto) {}, board),
               std::runtime_error);
}

TEST(CameraWorker, EveryStepIsSeenInItsOwnImageInLockstep) {
  Rig rig;
  rig.begin(1, Phase::demonstration);
  StatusBoard board;
  std::vector<std::shared_ptr<const CameraFrame>> frames;
  CameraWorker camera(
      rig.simulation, settings(), true, [&](auto frame) { frames.push_back(frame); }, board);
  policy::PolicySlot slot;
  PolicyWorker worker(*rig.task, slot, 0, &camera);
  for (int32_t step = 0; step < 5; ++step) {
    ASSERT_TRUE(worker.ask(rig.begin_step()));
    while (!worker.answer()) worker.answered().wait_for(std::chrono::milliseconds(100));
    EXPECT_EQ(worker.answer()->observation.image_step, step);
    ASSERT_EQ(frames.size(), static_cast<size_t>(step) + 1) << "the recorder has it first";
    EXPECT_EQ(frames.back()->step, step);
    worker.pop_answer();
    Twist down = Twist::Zero();
    down[2] = -1.0;
    rig.hear(down, true);
    rig.run_step();
  }
  EXPECT_NE(frames.front()->jpeg, frames.back()->jpeg);
  EXPECT_EQ(board.camera_frames, 5);
  EXPECT_EQ(board.camera_late, 0);
}

TEST(CameraWorker, ControlThreadHandsTheSceneOverWithoutAllocatingOrWaiting) {
  Rig rig;
  rig.begin(1);
  StatusBoard board;
  CameraWorker camera(
      rig.simulation, settings(), false, [](auto) {}, board);
  const StepSnapshot snapshot = rig.begin_step();
  int taken = 0;
  const testing::AllocationCounter allocations;
  const int64_t start_us = monotonic_us();
  for (int i = 0; i < 100; ++i) taken += camera.ask(snapshot);
  const int64_t us = monotonic_us() - start_us;
  EXPECT_EQ(allocations.count(), 0);
  EXPECT_GE(taken, 16);
  EXPECT_LT(us, 5'000) << "a hundred frames take a hundred times longer";
}

}  // namespace
}  // namespace tandem
