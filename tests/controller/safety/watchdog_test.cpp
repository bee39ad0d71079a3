#include "controller/safety/watchdog.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <limits>

#include "base/random.h"
#include "controller/law/law_rig.h"

namespace tandem {
namespace {

std::string refusal(const std::string& text) {
  const std::string path = ::testing::TempDir() + "watchdog.yaml";
  std::ofstream(path) << text;
  try {
    read_watchdog(Section::load(path));
  } catch (const ScenarioError& error) {
    return error.what();
  }
  return "accepted";
}

std::string scenario(const std::string& policy, const std::string& human) {
  return "policy: {" + policy + "}\noperator: {" + human +
         "}\nlink: {hold_after_ms: 1, damp_after_ms: 2, stop_after_ms: 3}\n";
}

const std::string kGood = "hold_after_ms: 1, damp_after_ms: 2, stop_after_ms: 3";

TEST(Watchdog, GradesFollowTheAge) {
  const WatchdogLimits limits{20.0, 1000.0, 10000.0};
  EXPECT_EQ(limits.grade(0.0), Grade::fresh);
  EXPECT_EQ(limits.grade(20.0), Grade::fresh);
  EXPECT_EQ(limits.grade(20.001), Grade::hold);
  EXPECT_EQ(limits.grade(1000.0), Grade::hold);
  EXPECT_EQ(limits.grade(1001.0), Grade::damp);
  EXPECT_EQ(limits.grade(10000.0), Grade::damp);
  EXPECT_EQ(limits.grade(10001.0), Grade::stop);
}

TEST(Watchdog, WhatIsNotAnAgeIsSilenceAndAClockThatStepsBackIsNot) {
  const WatchdogLimits limits{20.0, 1000.0, 10000.0};
  EXPECT_EQ(limits.grade(std::numeric_limits<double>::quiet_NaN()), Grade::stop);
  EXPECT_EQ(limits.grade(std::numeric_limits<double>::infinity()), Grade::stop);
  EXPECT_EQ(limits.grade(-1.0), Grade::fresh);
}

TEST(Watchdog, LongerSilenceIsNeverJudgedMilder) {
  Random random{3};
  for (int sample = 0; sample < 20000; ++sample) {
    WatchdogLimits limits;
    limits.hold_after_ms = random.uniform(0, 100);
    limits.damp_after_ms = limits.hold_after_ms + random.uniform(0, 100);
    limits.stop_after_ms = limits.damp_after_ms + random.uniform(0, 100);
    const double age = random.uniform(-10, 400), longer = age + random.uniform(0, 100);
    ASSERT_LE(limits.grade(age), limits.grade(longer));
  }
}

TEST(Watchdog, DefaultsHoldWithinAThirdOfASecondAndStopWithinTen) {
  const WatchdogSettings settings = read_watchdog(testing::controller_config().section("watchdog"));
  for (const WatchdogLimits& limits : {settings.policy, settings.operator_, settings.link}) {
    EXPECT_LE(limits.hold_after_ms, 300.0);
    EXPECT_LE(limits.stop_after_ms, 10000.0);
    EXPECT_EQ(limits.grade(0.0), Grade::fresh);
  }
  EXPECT_EQ(settings.policy.hold_after_ms, 20.0);
  EXPECT_EQ(settings.operator_.hold_after_ms, 250.0);
  EXPECT_EQ(settings.operator_release_after_ms, 1000.0);
  EXPECT_EQ(settings.link.stop_after_ms, 5000.0);
}

TEST(Watchdog, AgesOutOfOrderAreRefused) {
  EXPECT_EQ(refusal(scenario(kGood, kGood + ", release_after_ms: 1")), "accepted");
  const std::string damp = refusal(scenario(
      "hold_after_ms: 30, damp_after_ms: 20, stop_after_ms: 40", kGood + ", release_after_ms: 1"));
  EXPECT_NE(damp.find("watchdog.yaml:1: policy.damp_after_ms is 20 ms; it must not be less than "
                      "hold_after_ms, which is 30 ms."),
            std::string::npos)
      << damp;
  const std::string release = refusal(scenario(kGood, kGood + ", release_after_ms: 0.5"));
  EXPECT_NE(release.find("operator.release_after_ms is 0.5 ms"), std::string::npos) << release;
  const std::string unknown = refusal(scenario(kGood + ", hold: 3", kGood));
  EXPECT_NE(unknown.find("hold is not a known key"), std::string::npos) << unknown;
}

}  // namespace
}  // namespace tandem
