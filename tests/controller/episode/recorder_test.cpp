#include "controller/episode/recorder.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <sstream>
#include <tandem/episode_step_t.hpp>

#include "base/sha256.h"
#include "controller/episode/provenance.h"

namespace tandem {
namespace {

constexpr int kObservation = 2;

/// Pushes an episode of `n` steps as the control thread would; observation of step t is (t, 10 t).
void push_episode(SpscRing<Record>& ring, int64_t number, int n, Outcome outcome,
                  int human_from = 1000) {
  ring.push(EpisodeBegin{
      .episode = number, .episode_seed = 5, .phase = Phase::training, .policy_version = 3});
  for (int t = 0; t <= n; ++t) {
    ObservationRecord observation{.step = t};
    observation.values[0] = static_cast<float>(t);
    observation.values[1] = static_cast<float>(10 * t);
    ring.push(observation);
    if (t == n) break;
    StepRecord step;
    step.step = t;
    step.executed[0] = 0.1 * t;
    step.intervention = t >= human_from;
    step.took_over = t == human_from;
    step.force_peak = t;
    ring.push(step);
  }
  ring.push(EpisodeFinish{.utime = 1, .outcome = outcome});
}

std::vector<std::shared_ptr<const FinishedEpisode>> record(
    const std::function<void(SpscRing<Record>&)>& push, EventLog* log = nullptr) {
  std::vector<std::shared_ptr<const FinishedEpisode>> episodes;
  SpscRing<Record> ring(512);
  StatusBoard board;
  TaskSpec task;
  RecorderSinks sinks;
  sinks.episode = [&](auto episode) { episodes.push_back(std::move(episode)); };
  Recorder recorder(ring, log, task, kObservation, {.discount = 0.9}, sinks, board);
  push(ring);
  recorder.stop();
  return episodes;
}

episode_step_t decode(const std::vector<uint8_t>& bytes) {
  episode_step_t m;
  EXPECT_GT(m.decode(bytes.data(), 0, static_cast<int>(bytes.size())), 0);
  return m;
}

TEST(Recorder, NextObservationIsTheFollowingOneOfTheSameEpisode) {
  const auto episodes = record([](auto& ring) {
    push_episode(ring, 0, 3, Outcome::success);
    push_episode(ring, 1, 2, Outcome::timeout);
  });
  ASSERT_EQ(episodes.size(), 2u);
  const episode_step_t last = decode(episodes[0]->steps[2]);
  EXPECT_EQ(last.observation, (std::vector<float>{2, 20}));
  EXPECT_EQ(last.next_observation, (std::vector<float>{3, 30}));
}

TEST(Recorder, TerminatedAndTruncatedAreKeptApart) {
  const auto episodes = record([](auto& ring) {
    push_episode(ring, 0, 3, Outcome::success);
    push_episode(ring, 1, 2, Outcome::timeout);
  });
  const episode_step_t success = decode(episodes[0]->steps.back()),
                       timeout = decode(episodes[1]->steps.back());
  EXPECT_EQ(success.terminated, 1);
  EXPECT_EQ(success.truncated, 0);
  EXPECT_EQ(success.reward, 1.0f);
  EXPECT_FLOAT_EQ(decode(episodes[0]->steps[0]).discounted_return, 0.81f);
  EXPECT_EQ(timeout.terminated, 0);
  EXPECT_EQ(timeout.truncated, 1);
  EXPECT_EQ(timeout.discounted_return, 0.0f);
}

TEST(Recorder, EndCarriesDigestOfTheStepsAndCountsInterventions) {
  const auto episodes = record([](auto& ring) { push_episode(ring, 4, 5, Outcome::success, 2); });
  const FinishedEpisode& episode = *episodes.at(0);
  Sha256 digest;
  for (const auto& step : episode.steps) digest.add(step.data(), step.size());
  EXPECT_EQ(episode.end.steps_sha256, digest.hex());
  EXPECT_EQ(episode.end.n_steps, 5);
  EXPECT_EQ(episode.end.n_intervention_steps, 3);
  EXPECT_EQ(episode.end.n_takeovers, 1);
  EXPECT_EQ(episode.end.force_peak, 4.0);
  EXPECT_EQ(episode.end.env_steps_total, 5);
}

TEST(Recorder, StepWithoutItsNextObservationIsNotATransition) {
  const auto episodes = record([](auto& ring) {
    push_episode(ring, 0, 2, Outcome::fault);
    ring.push(EpisodeBegin{.episode = 1});
    ring.push(ObservationRecord{.step = 0});
    ring.push(StepRecord{});
    ring.push(EpisodeFinish{.outcome = Outcome::fault});
  });
  EXPECT_EQ(episodes.at(1)->end.n_steps, 0);
}

class EventLogTest : public ::testing::Test {
 protected:
  std::string path_ = ::testing::TempDir() + "event_log_test_" + std::to_string(getpid()) + ".lcm";
  void TearDown() override { std::filesystem::remove(path_); }
};

TEST_F(EventLogTest, CutOffTailIsRemovedAndTheRunContinues) {
  {
    EventLog log(path_);
    record([](auto& ring) { push_episode(ring, 0, 3, Outcome::success); }, &log);
  }
  const auto whole = std::filesystem::file_size(path_);
  {
    EventLog log(path_);
    log.write("ROBOT_STATE", 5, std::vector<uint8_t>(100, 7));
    log.flush();
  }
  std::filesystem::resize_file(path_, std::filesystem::file_size(path_) - 30);
  EventLog log(path_);
  ASSERT_EQ(log.past().episodes.size(), 1u);
  EXPECT_EQ(log.past().episodes[0].n_steps, 3);
  EXPECT_EQ(std::filesystem::file_size(path_), whole);
}

TEST_F(EventLogTest, WhatWasHandedOverIsOnDiskBeforeTheEpisodeEnds) {
  SpscRing<Record> ring(64);
  EventLog log(path_);
  TaskSpec task;
  StatusBoard board;
  Recorder recorder(ring, &log, task, 2, {.every_tick = true}, {}, board);
  ring.push(EpisodeBegin{});
  ring.push(TickRecord{});
  for (int i = 0; i < 1000 && std::filesystem::file_size(path_) == 0; ++i) usleep(1000);
  EXPECT_GT(std::filesystem::file_size(path_), 300u);  // a whole CONTROL_TICK
}

TEST_F(EventLogTest, UnwritableFolderIsASentence) {
  try {
    EventLog log("/proc/no_such_folder/log.lcm");
    FAIL();
  } catch (const std::runtime_error& error) {
    EXPECT_NE(std::string(error.what()).find("can't be written"), std::string::npos);
  }
}

TEST_F(EventLogTest, FullDiskIsASentenceNotASilence) {
  EventLog log("/dev/full");
  for (int i = 0; i < 100; ++i) log.write("ROBOT_STATE", i, std::vector<uint8_t>(1000));
  log.flush();
  EXPECT_NE(log.failure().find("can't be written any more"), std::string::npos);
}

TEST(Provenance, HoldsEveryMessageTypeAsItsFileHasIt) {
  const provenance_t m = provenance("abc", "run: {}", 7, 12);
  EXPECT_EQ(m.run_seed, 7);
  EXPECT_EQ(m.continues_with, 12);
  EXPECT_EQ(m.program_revision, "abc");
  int files = 0;
  for (const auto& file : std::filesystem::directory_iterator(TANDEM_ROOT "/lcm_types")) {
    if (file.path().extension() != ".lcm") continue;
    ++files;
    std::ostringstream text;
    text << std::ifstream(file.path()).rdbuf();
    const auto name = std::find(m.type_names.begin(), m.type_names.end(), file.path().stem());
    ASSERT_NE(name, m.type_names.end()) << file.path();
    EXPECT_EQ(m.type_texts[static_cast<size_t>(name - m.type_names.begin())], text.str());
  }
  EXPECT_EQ(files, m.n_types);
}

}  // namespace
}  // namespace tandem
