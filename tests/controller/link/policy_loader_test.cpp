#include "controller/link/policy_loader.h"

#include <gtest/gtest.h>

#include <condition_variable>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "controller/rig.h"
#include "policy_runtime/policy_file.h"

namespace tandem {
namespace {

using std::chrono::milliseconds;

class PolicyLoaderTest : public ::testing::Test {
 protected:
  /// A sound policy for the peg task.
  policy::testing::PolicyFile peg_policy(int version) const {
    auto file = policy::testing::make_mlp({.observation_size = task_->observation().size(),
                                           .hidden = {8},
                                           .axes = task_->spec().action_axes,
                                           .horizon = 1,
                                           .version = version});
    file.metadata["task"] = "peg";
    file.metadata["observation"] = nlohmann::json(task_->observation().names()).dump();
    return file;
  }

  std::string refusal(const policy::testing::PolicyFile& file, int horizon = 1,
                      const std::string& sha256 = "") {
    try {
      load_policy(policy::testing::write_file(file), sha256, *task_, horizon);
    } catch (const std::exception& error) {
      return error.what();
    }
    return "";
  }

  policy_announce_t announcement(int version, int64_t through) {
    policy_announce_t m{};
    m.version = version;
    m.path = policy::testing::write_file(peg_policy(version));
    m.episodes_trained_through = through;
    return m;
  }

  std::unique_ptr<Task> task_ = make_task(testing::config("tasks/peg.yaml"));
};

TEST_F(PolicyLoaderTest, TakesAPolicyOfThisTask) { EXPECT_EQ(refusal(peg_policy(1)), ""); }

TEST_F(PolicyLoaderTest, RefusesWhatWasTrainedForSomethingElseWithASentence) {
  auto other = peg_policy(1);
  other.metadata["task"] = "square";
  EXPECT_NE(refusal(other).find("for the task 'square', not for 'peg'"), std::string::npos);

  other = peg_policy(1);
  auto names = task_->observation().names();
  std::swap(names[0], names[1]);
  other.metadata["observation"] = nlohmann::json(names).dump();
  EXPECT_NE(refusal(other).find("trained on the observation"), std::string::npos);

  EXPECT_NE(refusal(peg_policy(1), 4).find("method.horizon is 4"), std::string::npos);
  EXPECT_NE(refusal(peg_policy(1), 1, "00").find("SHA-256"), std::string::npos);
}

TEST_F(PolicyLoaderTest, TaskThatIsSeenTakesNoPolicyThatWasToldWhereThingsAre) {
  const auto told = peg_policy(1);
  task_->hide_truth();
  for (const std::string& name : task_->observation().names())
    EXPECT_EQ(name.find("goal"), std::string::npos);
  EXPECT_EQ(task_->observation().size(), 15);
  EXPECT_NE(refusal(told).find("trained on the observation"), std::string::npos);
  EXPECT_EQ(refusal(peg_policy(1)), "");
}

TEST_F(PolicyLoaderTest, LockstepPutsExactlyTheAskedPolicyInForce) {
  policy::PolicySlot slot;
  std::atomic<int> acks{0};
  PolicyLoader loader(slot, *task_, {.run_folder = "/", .horizon = 1, .lockstep = true},
                      [&](const policy_ack_t& ack) { acks += ack.accepted; });
  loader.announce(announcement(1, 19));
  loader.announce(announcement(2, 20));
  loader.announce(announcement(3, 21));
  EXPECT_EQ(loader.put_in_force(20, milliseconds(3000)), 2);
  EXPECT_EQ(slot.acquire()->policy->header().version, 2);
  EXPECT_EQ(loader.put_in_force(20, milliseconds(3000)), 2);  // two episodes may want the same
  EXPECT_EQ(loader.put_in_force(25, milliseconds(50)), 0);    // not there yet
  EXPECT_EQ(loader.put_in_force(21, milliseconds(3000)), 3);
  EXPECT_EQ(acks, 3);
}

TEST_F(PolicyLoaderTest, RefusedPolicyIsAcknowledgedWithItsReasonAndChangesNothing) {
  policy::PolicySlot slot;
  std::mutex mutex;
  std::condition_variable heard;
  std::vector<policy_ack_t> acks;
  PolicyLoader loader(slot, *task_, {.run_folder = "/", .horizon = 1, .lockstep = false},
                      [&](const policy_ack_t& ack) {
                        const std::lock_guard lock(mutex);
                        acks.push_back(ack);
                        heard.notify_all();
                      });
  policy_announce_t missing = announcement(1, 19);
  missing.path = "/no/such/file.safetensors";
  loader.announce(missing);
  std::unique_lock lock(mutex);
  ASSERT_TRUE(heard.wait_for(lock, milliseconds(3000), [&] { return acks.size() == 1; }));
  EXPECT_EQ(acks[0].accepted, 0);
  EXPECT_FALSE(acks[0].reason.empty());
  lock.unlock();
  EXPECT_EQ(loader.refusal(), acks[0].reason);
  EXPECT_EQ(slot.acquire(), nullptr);
}

TEST_F(PolicyLoaderTest, RefusesWhatIsNoRegularFileInsteadOfReadingItForEver) {
  EXPECT_THROW(load_policy("/dev/zero", std::string(64, 'a'), *task_, 1), std::runtime_error);
  EXPECT_THROW(load_policy(".", "", *task_, 1), std::runtime_error);
}

TEST_F(PolicyLoaderTest, RefusesAFileOfAnotherVersionThanAnnouncedAndForgetsItAfterAGoodOne) {
  policy::PolicySlot slot;
  std::atomic<int> answers{0};
  PolicyLoader loader(slot, *task_, {.run_folder = "", .horizon = 1, .lockstep = false},
                      [&](const policy_ack_t&) { ++answers; });
  const auto answered = [&](int n) {
    for (int i = 0; i < 500 && answers < n; ++i) std::this_thread::sleep_for(milliseconds(10));
  };
  policy_announce_t wrong = announcement(3, 1);
  wrong.version = 4;
  loader.announce(wrong);
  answered(1);
  EXPECT_NE(loader.refusal().find("holds version 3, announced was 4"), std::string::npos);
  EXPECT_EQ(loader.version_in_force(), 0);
  loader.announce(announcement(5, 2));
  answered(2);
  EXPECT_EQ(loader.refusal(), "");
  EXPECT_EQ(loader.version_in_force(), 5);
}

}  // namespace
}  // namespace tandem
