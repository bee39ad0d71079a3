#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <lcm/lcm-cpp.hpp>
#include <memory>
#include <opencv2/core.hpp>
#include <tandem/episode_end_t.hpp>
#include <tandem/robot_state_t.hpp>
#include <tandem/scenario_t.hpp>
#include <tandem/world_state_t.hpp>

#include "controller/render/covers.h"
#include "controller/render/overlay.h"
#include "controller/render/recording.h"
#include "controller/render/scene_view.h"
#include "controller/render/video.h"
#include "controller/robot/scenes.h"

namespace tandem {
namespace {

using namespace testing;

// A log as the controller writes it: `episodes` episodes of three steps, in each of which joint 1
// turns by 0.3 rad.
class LogWriter {
 public:
  explicit LogWriter(const std::string& path) : log_(path, "w") {}

  void scenario(const std::string& yaml) {
    scenario_t m{};
    m.scenario_yaml = yaml;
    write("SCENARIO", m);
  }

  void episode(int64_t number, bool complete) {
    for (int64_t tick = 0; tick <= 300; tick += 10) {
      JointVector q = home();
      q[0] = 1e-3 * static_cast<double>(tick);
      if (tick % 100 == 0) world(number, tick, q);
      robot_state_t m{};
      m.tick = tick;
      m.episode = number;
      JointVector::Map(m.q_measured) = q;
      m.gripper_width = kPegWidth;
      m.alpha = tick > 150 ? 1.0 : 0.0;
      write("ROBOT_STATE", m);
    }
    if (!complete) return;
    episode_end_t end{};
    end.episode = number;
    end.n_steps = 3;
    end.outcome = episode_end_t::SUCCESS;
    write("EPISODE_END", end);
  }

 private:
  void world(int64_t number, int64_t tick, const JointVector& q) {
    arm_.update(q, JointVector::Zero(), state_);
    const Pose X_EO{Eigen::Vector3d(0.001, 0, 0.06), Eigen::Quaterniond::Identity()};
    world_state_t m{};
    m.tick = tick;
    m.episode = number;
    m.max_steps = 120;
    put(state_.X_WE, m.p_WE, m.q_WE);
    put(state_.X_WE * X_EO, m.p_WO, m.q_WO);
    put({Eigen::Vector3d(0.45, 0.02, 0.04), Eigen::Quaterniond::Identity()}, m.p_WG, m.q_WG);
    write("WORLD_STATE", m);
  }
  static void put(const Pose& X, double* p, double* q) {
    Eigen::Vector3d::Map(p) = X.p;
    q[0] = X.R.w(), q[1] = X.R.x(), q[2] = X.R.y(), q[3] = X.R.z();
  }
  template <typename Message>
  void write(const std::string& channel, const Message& message) {
    std::vector<uint8_t> bytes(static_cast<size_t>(message.getEncodedSize()));
    message.encode(bytes.data(), 0, static_cast<int>(bytes.size()));
    lcm::LogEvent event{};
    event.channel = channel;
    event.data = bytes.data();
    event.datalen = static_cast<int32_t>(bytes.size());
    log_.writeEvent(&event);
  }

  lcm::LogFile log_;
  ArmModel arm_{kUrdf};
  ArmState state_;
};

const std::string kScenario =
    "task: {scene: models/peg/scene.xml, difficulty: normal, clearance_m: {normal: 0.0005}}";

std::string log_of(const std::string& name, int episodes, bool unfinished) {
  const std::string path = ::testing::TempDir() + name;
  LogWriter log(path);
  log.scenario(kScenario);
  for (int i = 0; i < episodes; ++i) log.episode(i, true);
  if (unfinished) log.episode(episodes, false);
  return path;
}

TEST(Recording, KeepsTheLastCompleteEpisodesAndIgnoresACutOffTail) {
  const std::string path = log_of("tail.lcm", 3, true);
  std::filesystem::resize_file(path, std::filesystem::file_size(path) - 7);
  const Recording recording = read_recording(path, 2);
  EXPECT_EQ(recording.scene, "models/peg/scene.xml");
  EXPECT_EQ(recording.scenario, kScenario);
  ASSERT_EQ(recording.episodes.size(), 2u);
  EXPECT_EQ(recording.episodes[0].number, 1);
  EXPECT_EQ(recording.episodes[1].number, 2);
  EXPECT_LT((recording.episodes[1].objects.front().X_EO.p - Eigen::Vector3d(0.001, 0, 0.06)).norm(),
            1e-12);
}

TEST(Recording, MomentsLieBetweenTheRecordedOnes) {
  const Recording recording = read_recording(log_of("moments.lcm", 1, false), 1);
  const RecordedEpisode& episode = recording.episodes.front();
  EXPECT_NEAR(episode.at(125.5).q[0], 0.1255, 1e-12);
  EXPECT_NEAR(episode.at(-5).q[0], 0.0, 1e-12);
  EXPECT_NEAR(episode.at(1e6).q[0], 0.3, 1e-12);
  EXPECT_EQ(episode.step_at(0), 0);
  EXPECT_EQ(episode.step_at(199.9), 1);
}

TEST(Recording, ALogWithNothingToDrawIsRefusedWithTheReason) {
  const std::string empty = log_of("empty.lcm", 0, false);
  const auto refusal = [](const std::string& path) -> std::string {
    try {
      read_recording(path, 1);
    } catch (const std::exception& error) {
      return error.what();
    }
    return "accepted";
  };
  EXPECT_NE(refusal(empty).find("no complete episode"), std::string::npos);
  EXPECT_EQ(refusal("no/such/log.lcm"), "no/such/log.lcm: the event log cannot be opened.");
}

TEST(Covers, AFolderWithoutTheArmIsRefused) {
  EXPECT_THROW(with_covers(kModels + "/panda/panda.xml", kModels), std::runtime_error);
  EXPECT_TRUE(find_covers("/no/such/root").empty());
}

class SceneViewTest : public ::testing::Test {
 protected:
  static double difference(const cv::Mat& a, const cv::Mat& b) {
    return cv::norm(a, b, cv::NORM_L1) / static_cast<double>(a.total());
  }

  cv::Mat draw(SceneView& view, double tick) const {
    return view.draw(episode_.at(tick), episode_.object_at(tick));
  }

  const Recording recording_ = read_recording(log_of("view.lcm", 1, false), 1);
  const RecordedEpisode& episode_ = recording_.episodes.front();
};

TEST_F(SceneViewTest, ArmMovesInThePictureAndThePegIsOrange) {
  SceneView view(kPegScene, {}, 320, 160);
  view.begin(episode_);
  const cv::Mat before = draw(view, 0), after = draw(view, 300);
  EXPECT_GT(difference(before, after), 1.0);
  EXPECT_EQ(difference(before, draw(view, 0)), 0.0);
  int orange = 0;
  for (int y = 0; y < before.rows; ++y) {
    for (int x = 0; x < before.cols; ++x) {
      const cv::Vec3b bgr = before.at<cv::Vec3b>(y, x);
      orange += bgr[2] > 120 && bgr[2] > 2 * bgr[0] && bgr[1] > bgr[0];
    }
  }
  EXPECT_GT(orange, 15);
  const Pose tip = view.simulation().site_pose(view.simulation().site("object"));
  EXPECT_LT((view.simulation().tool_pose().p +
             view.simulation().tool_pose().R * Eigen::Vector3d(0.001, 0, 0.06) - tip.p)
                .norm(),
            1e-9);
}

TEST_F(SceneViewTest, OverlayTellsWhoDrives) {
  SceneView view(kPegScene, {}, 320, 160);
  view.begin(episode_);
  cv::Mat machine = draw(view, 0), human = machine.clone();
  Moment taken = episode_.at(0);
  draw_overlay(machine, episode_, taken, false);
  taken.alpha = 1.0;
  draw_overlay(human, episode_, taken, false);
  EXPECT_GT(difference(machine, human), 0.5);
}

TEST_F(SceneViewTest, VideoIsWritten) {
  const std::string path = ::testing::TempDir() + "view.mp4";
  SceneView view(kPegScene, {}, 320, 160);
  view.begin(episode_);
  Video video(path, 320, 160, 20);
  for (int i = 0; i < 5; ++i) video.write(draw(view, 60.0 * i));
  video.close();
  EXPECT_GT(std::filesystem::file_size(path), 1000u);
  EXPECT_THROW(Video("/no/such/folder/view.mp4", 320, 160, 20), std::runtime_error);
}

}  // namespace
}  // namespace tandem
