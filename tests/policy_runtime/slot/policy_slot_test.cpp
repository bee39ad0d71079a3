#include "policy_runtime/slot/policy_slot.h"

#include <gtest/gtest.h>

#include <thread>

#include "policy_runtime/policy_file.h"
#include "support/allocation_counter.h"

namespace tandem::policy::testing {
namespace {

// Answers with its version; notices when it is used after its death or destroyed on a thread that
// must not.
class Marked final : public Head {
 public:
  inline static std::atomic<int> alive{0};
  inline static std::thread::id loader;
  inline static std::atomic<int> destroyed_elsewhere{0};

  explicit Marked(int version) : Head(1, 1), value_(float(version)) { ++alive; }
  ~Marked() override {
    value_ = -1.0f;
    --alive;
    if (std::this_thread::get_id() != loader) ++destroyed_elsewhere;
  }

  std::size_t workspace_size(int) const noexcept override { return 16; }
  void forward(const HeadInput&, int, float* chunks, float* workspace) const noexcept override {
    workspace[0] = value_;
    chunks[0] = workspace[0];
  }

 private:
  float value_;
};

std::unique_ptr<const Policy> marked(int version) {
  Header header;
  header.version = version;
  header.horizon = 1;
  header.action_axes = {"x"};
  return std::make_unique<Policy>(header, std::vector<float>{}, std::vector<float>{},
                                  std::make_unique<Marked>(version));
}

class PolicySlotTest : public ::testing::Test {
 protected:
  void SetUp() override {
    Marked::loader = std::this_thread::get_id();
    Marked::destroyed_elsewhere = 0;
  }
  void TearDown() override { EXPECT_EQ(Marked::destroyed_elsewhere, 0); }
};

TEST_F(PolicySlotTest, IsEmptyBeforeTheFirstPolicy) {
  PolicySlot slot;
  EXPECT_EQ(slot.acquire(), nullptr);
  EXPECT_EQ(slot.version_in_force(), -1);
}

TEST_F(PolicySlotTest, FreesThePreviousPolicyOnlyAfterTheReaderMovedOn) {
  {
    PolicySlot slot;
    slot.publish(marked(1));
    EXPECT_EQ(slot.version_in_force(), -1) << "published is not yet in force";
    PolicySlot::Active* first = slot.acquire();
    EXPECT_EQ(first->policy->header().version, 1);
    EXPECT_EQ(slot.acquire(), first);

    slot.publish(marked(2));
    slot.collect();
    EXPECT_EQ(slot.version_in_force(), 1);
    EXPECT_EQ(Marked::alive, 2) << "the reader still holds version 1";
    float value = 0.0f;
    EXPECT_TRUE(first->forward({}, &value));
    EXPECT_EQ(value, 1.0f);

    EXPECT_EQ(slot.acquire()->policy->header().version, 2);
    EXPECT_EQ(slot.version_in_force(), 2);
    EXPECT_EQ(Marked::alive, 2) << "the reader never frees";
    slot.collect();
    EXPECT_EQ(Marked::alive, 1);
  }
  EXPECT_EQ(Marked::alive, 0);
}

TEST_F(PolicySlotTest, SkippedPoliciesDoNotPileUp) {
  PolicySlot slot;
  for (int version = 1; version <= 100; ++version) slot.publish(marked(version));
  EXPECT_EQ(slot.alive(), 1u);
  EXPECT_EQ(slot.acquire()->policy->header().version, 100);
}

TEST_F(PolicySlotTest, AcquireNeitherAllocatesNorFrees) {
  PolicySlot slot;
  slot.publish(marked(1));
  slot.acquire();
  slot.publish(marked(2));
  const tandem::testing::AllocationCounter allocations;
  slot.acquire();
  EXPECT_EQ(allocations.count(), 0);
  EXPECT_EQ(Marked::alive, 2);
}

// Meant for ThreadSanitizer and AddressSanitizer as much as for its own checks.
TEST_F(PolicySlotTest, SurvivesAThousandSwapsAgainstABusyReader) {
  constexpr int kSwaps = 1000;
  {
    PolicySlot slot;
    std::atomic<bool> stop{false};
    long wrong = 0, backwards = 0, seen = 0;

    std::thread reader([&] {
      std::int64_t last = 0;
      while (!stop.load()) {
        PolicySlot::Active* active = slot.acquire();
        if (active == nullptr) continue;
        const std::int64_t version = active->policy->header().version;
        if (version < last) ++backwards;
        if (version != last) ++seen;
        last = version;
        for (int step = 0; step < 20; ++step) {
          float value = 0.0f;
          if (!active->forward({}, &value) || value != float(version)) ++wrong;
        }
      }
    });

    for (int version = 1; version <= kSwaps; ++version) {
      slot.publish(marked(version));
      // every other time let the reader take it, so that both taken and skipped policies occur
      while (version % 2 == 0 && slot.version_in_force() != version) std::this_thread::yield();
    }
    while (slot.version_in_force() != kSwaps) std::this_thread::yield();
    stop = true;
    reader.join();

    EXPECT_EQ(wrong, 0);
    EXPECT_EQ(backwards, 0);
    EXPECT_GE(seen, kSwaps / 2);
    slot.collect();
    EXPECT_EQ(slot.alive(), 1u);
  }
  EXPECT_EQ(Marked::alive, 0);
}

TEST_F(PolicySlotTest, CarriesALoadedPolicy) {
  PolicySlot slot;
  slot.publish(Policy::load(write_file(make_mlp({.version = 5}))));
  std::vector<float> observation(7), chunk(6);
  EXPECT_TRUE(slot.acquire()->forward({.observation = observation.data()}, chunk.data()));
  EXPECT_EQ(slot.version_in_force(), 5);
}

}  // namespace
}  // namespace tandem::policy::testing
