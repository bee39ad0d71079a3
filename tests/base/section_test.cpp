#include "base/section.h"

#include <gtest/gtest.h>

#include <fstream>

namespace tandem {
namespace {

class SectionTest : public ::testing::Test {
 protected:
  Section load(const std::string& yaml) {
    path_ = ::testing::TempDir() + "section_test_" + std::to_string(getpid()) + ".yaml";
    std::ofstream(path_) << yaml;
    return Section::load(path_);
  }
  void TearDown() override { std::remove(path_.c_str()); }

  template <typename Function>
  std::string refusal(Function function) {
    try {
      function();
    } catch (const ScenarioError& error) {
      return error.what();
    }
    return "accepted";
  }

  std::string path_;
};

TEST_F(SectionTest, UnknownKeyIsRefusedWithItsLineAndTheNearestName) {
  Section root = load("task:\n  max_steps: 5\n  policy_rate_hs: 10\n");
  Section task = root.section("task");
  task.integer("max_steps", 1, 10);
  const std::string said = refusal([&] {
    try {
      task.number("policy_rate_hz", 1, 200);
    } catch (const ScenarioError&) {
    }
    task.finish();
  });
  EXPECT_EQ(
      said,
      path_ + ":3: task.policy_rate_hs is not a known key. Did you mean 'task.policy_rate_hz'?");
}

TEST_F(SectionTest, ValueOutOfRangeIsRefusedWithValueAndRange) {
  Section root = load("a: 1\nrate_hz: 0\n");
  EXPECT_EQ(refusal([&] { root.number("rate_hz", 1, 200); }),
            path_ + ":2: rate_hz is 0; it must be in [1, 200].");
}

TEST_F(SectionTest, NotANumberIsRefused) {
  Section root = load("rate_hz: .nan\nn: fast\n");
  EXPECT_NE(refusal([&] { root.number("rate_hz", 1, 200); }).find("must be in [1, 200]"),
            std::string::npos);
  EXPECT_NE(refusal([&] { root.integer("n", 1, 200); }).find("not a whole number"),
            std::string::npos);
}

TEST_F(SectionTest, MissingKeyIsRefused) {
  Section root = load("a: 1\n");
  EXPECT_NE(refusal([&] { root.number("b", 0, 1); }).find("b is missing"), std::string::npos);
}

TEST_F(SectionTest, ListOfWrongLengthIsRefused) {
  Section root = load("k: [1, 2]\n");
  EXPECT_NE(refusal([&] { root.numbers("k", 3, 0, 9); }).find("has 2 entries"), std::string::npos);
}

TEST_F(SectionTest, BrokenYamlIsRefusedWithItsLine) {
  EXPECT_NE(refusal([&] { load("a: 1\nb: [1,\n"); }).find("not valid YAML"), std::string::npos);
}

}  // namespace
}  // namespace tandem
