#include "controller/episode/recorder.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <map>
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

std::shared_ptr<const CameraFrame> frame(int64_t episode, int32_t step) {
  auto frame = std::make_shared<CameraFrame>();
  frame->episode = episode;
  frame->step = step;
  frame->jpeg = {static_cast<uint8_t>(episode), static_cast<uint8_t>(step)};
  return frame;
}

TEST(Recorder, StepCarriesTheImageThatThePolicySawAndTheLastOneWhatItWouldHaveSeen) {
  std::vector<std::shared_ptr<const FinishedEpisode>> episodes;
  SpscRing<Record> ring(512);
  StatusBoard board;
  TaskSpec task;
  RecorderSinks sinks;
  sinks.episode = [&](auto episode) { episodes.push_back(std::move(episode)); };
  Recorder recorder(ring, nullptr, task, kObservation, {}, sinks, board);
  for (int64_t episode = 0; episode < 2; ++episode) {
    ring.push(EpisodeBegin{.episode = episode});
    for (int32_t t = 0; t <= 3; ++t) {
      recorder.keep(frame(episode, t));
      // The camera was late for step 2, which had to do with the image of step 1.
      ring.push(ObservationRecord{.step = t, .image_step = t == 2 ? 1 : t});
      if (t < 3) ring.push(StepRecord{.step = t});
    }
    ring.push(EpisodeFinish{.outcome = Outcome::success});
  }
  recorder.stop();
  ASSERT_EQ(episodes.size(), 2u);
  ASSERT_EQ(episodes[1]->steps.size(), 3u);
  const uint8_t seen[] = {0, 1, 1};
  for (uint8_t t = 0; t < 3; ++t) {
    const episode_step_t step = decode(episodes[1]->steps[t]);
    EXPECT_EQ(step.image, (std::vector<uint8_t>{1, seen[t]}));
    const std::vector<uint8_t> next = t == 2 ? std::vector<uint8_t>{1, 3} : std::vector<uint8_t>{};
    EXPECT_EQ(step.next_image, next);
  }
}

TEST(Recorder, StepWithoutAnImageIsNotATransitionWhereOthersHaveOne) {
  std::vector<std::shared_ptr<const FinishedEpisode>> episodes;
  SpscRing<Record> ring(512);
  StatusBoard board;
  TaskSpec task;
  RecorderSinks sinks;
  sinks.episode = [&](auto episode) { episodes.push_back(std::move(episode)); };
  Recorder recorder(ring, nullptr, task, kObservation, {}, sinks, board);
  ring.push(EpisodeBegin{.episode = 0});
  for (int32_t t = 0; t <= 3; ++t) {
    recorder.keep(frame(0, t));
    ring.push(ObservationRecord{.step = t, .image_step = t == 2 ? -1 : t});
    if (t < 3) ring.push(StepRecord{.step = t});
  }
  ring.push(EpisodeFinish{.outcome = Outcome::timeout});
  recorder.stop();
  EXPECT_EQ(episodes.at(0)->end.n_steps, 1);
}

class EventLogTest : public ::testing::Test {
 protected:
  std::string path_ = ::testing::TempDir() + "event_log_test_" + std::to_string(getpid()) + ".lcm";
  void TearDown() override {
    for (int n = 0; n < 100; ++n) std::filesystem::remove(log_file(path_, static_cast<size_t>(n)));
  }

  std::string bytes(size_t n) const {
    std::ostringstream text;
    text << std::ifstream(log_file(path_, n), std::ios::binary).rdbuf();
    return text.str();
  }

  /// The channels of all events, as LCM reads a file or the whole log.
  template <typename Read>
  static std::map<std::string, int> channels(Read read) {
    std::map<std::string, int> found;
    while (const lcm::LogEvent* event = read()) ++found[event->channel];
    return found;
  }
  std::map<std::string, int> all_channels() const {
    EventReader log(path_);
    return channels([&] { return log.next(); });
  }
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

/// An episode with one tick, one world state and `n` steps.
void push_moving_episode(SpscRing<Record>& ring, int64_t number, int n) {
  ring.push(EpisodeBegin{.episode = number, .phase = Phase::training});
  ring.push(StepSnapshot{});
  ring.push(TickRecord{});
  ring.push(HumanCommand{});
  ChunkRecord chunk;
  chunk.chunk.actions.fill(Action::Zero());
  ring.push(chunk);
  for (int t = 0; t <= n; ++t) {
    ring.push(ObservationRecord{.step = t});
    if (t < n) ring.push(StepRecord{.step = t});
  }
  ring.push(EpisodeFinish{.outcome = Outcome::success});
}

TEST_F(EventLogTest, FilesInARowAreTheLogThatOneFileWouldBe) {
  const auto push = [](auto& ring) {
    for (int64_t e = 0; e < 6; ++e) push_moving_episode(ring, e, 3);
  };
  {
    EventLog log(path_);
    record(push, &log);
  }
  const std::string one = bytes(0);
  TearDown();
  {
    EventLog log(path_, {.file = static_cast<int64_t>(one.size() / 3)});
    record(push, &log);
    EXPECT_EQ(log.bytes(), static_cast<int64_t>(one.size()));
  }
  ASSERT_EQ(count_log_files(path_), 3u);
  std::map<std::string, int> by_file;
  for (size_t n = 0; n < 3; ++n) {
    lcm::LogFile file(log_file(path_, n), "r");
    const auto found = channels([&] { return file.readNextEvent(); });
    EXPECT_EQ(found.at("EPISODE_END"), 2);  // whole episodes
    for (const auto& [channel, count] : found) by_file[channel] += count;
  }
  EXPECT_EQ(all_channels(), by_file);
  // Byte for byte, but for LCM's event numbers, which begin anew in every file.
  const std::string several = bytes(0) + bytes(1) + bytes(2);
  ASSERT_EQ(several.size(), one.size());
  size_t differ = 0;
  for (size_t i = 0; i < one.size(); ++i) differ += one[i] != several[i];
  size_t events = 0;
  for (const auto& [channel, count] : by_file) events += static_cast<size_t>(count);
  EXPECT_LE(differ, events);  // numbers below 256: one byte each
}

TEST_F(EventLogTest, CutOffTailOfTheLastFileIsRemovedAndTheRunContinues) {
  const LogLimits limits{.file = 1};  // a file an episode
  {
    EventLog log(path_, limits);
    record(
        [](auto& ring) {
          push_moving_episode(ring, 0, 3);
          push_moving_episode(ring, 1, 4);
        },
        &log);
    log.begin_episode();
    log.write("ROBOT_STATE", 5, std::vector<uint8_t>(100, 7));  // killed in the third
  }
  ASSERT_EQ(count_log_files(path_), 3u);
  const std::string second = bytes(1);
  std::filesystem::resize_file(log_file(path_, 2), 60);
  EventLog log(path_, limits);
  ASSERT_EQ(log.past().episodes.size(), 2u);
  EXPECT_EQ(log.past().episodes[1].n_steps, 4);
  EXPECT_EQ(count_log_files(path_), 2u);
  EXPECT_EQ(bytes(1), second);
  EXPECT_EQ(log.bytes(), static_cast<int64_t>(bytes(0).size() + second.size()));
  record([](auto& ring) { push_moving_episode(ring, 2, 3); }, &log);
  EXPECT_EQ(all_channels().at("EPISODE_END"), 3);
  EXPECT_EQ(bytes(1), second);
}

TEST_F(EventLogTest, BeyondTheQuotaEpisodesGoOnWithoutMotion) {
  StatusBoard board;
  const auto recorded = [&](int episodes, int64_t quota) {
    SpscRing<Record> ring(512);
    EventLog log(path_, {.quota = quota});
    const TaskSpec task;
    RecorderSinks sinks;
    int shown = 0;
    sinks.robot_state = [&](const robot_state_t&) { ++shown; };
    Recorder recorder(ring, &log, task, kObservation, {.every_tick = true}, sinks, board);
    for (int e = 0; e < episodes; ++e) push_moving_episode(ring, e, 3);
    ring.push(FaultRecord{.fault = Fault::estop});
    recorder.stop();
    EXPECT_EQ(shown, episodes);  // who looks on sees all of it
    return log.bytes();
  };
  const int64_t whole = recorded(4, 0);
  TearDown();
  EXPECT_LT(recorded(4, whole / 2), whole);
  auto found = all_channels();
  for (const char* channel :
       {"ROBOT_STATE", "CONTROL_TICK", "WORLD_STATE", "TELEOP_COMMAND", "ACTION_CHUNK"})
    EXPECT_EQ(found[channel], 3) << channel;  // the third began within the quota
  EXPECT_EQ(found["EPISODE_STEP"], 12);
  EXPECT_EQ(found["EPISODE_END"], 4);
  EXPECT_EQ(found["CONTROLLER_FAULT"], 1);
  EXPECT_EQ(board.episodes_without_motion, 1);
}

TEST_F(EventLogTest, MissingFileIsASentenceAndNothingIsTouched) {
  {
    EventLog log(path_, {.file = 1});
    record(
        [](auto& ring) {
          for (int64_t e = 0; e < 3; ++e) push_moving_episode(ring, e, 3);
        },
        &log);
  }
  const std::string last = bytes(2);
  std::filesystem::remove(log_file(path_, 1));
  try {
    EventLog log(path_);
    FAIL() << "a run that goes on would overwrite or forget what follows";
  } catch (const std::runtime_error& error) {
    EXPECT_NE(std::string(error.what()).find(".lcm.01 is missing"), std::string::npos)
        << error.what();
  }
  EXPECT_EQ(bytes(2), last);
}

TEST_F(EventLogTest, FaultBetweenEpisodesIsKeptWhenTheRunContinues) {
  {
    EventLog log(path_);
    record(
        [](auto& ring) {
          push_moving_episode(ring, 0, 3);
          ring.push(FaultRecord{.utime = 9, .fault = Fault::estop});
        },
        &log);
  }
  const auto whole = std::filesystem::file_size(path_);
  EventLog log(path_);
  EXPECT_EQ(std::filesystem::file_size(path_), whole);
  EXPECT_EQ(all_channels().at("CONTROLLER_FAULT"), 1);
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
