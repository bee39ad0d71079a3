#include "intervention/command_check.h"

#include <gtest/gtest.h>

#include <cmath>

namespace tandem {
namespace {

teleop_command_t good_command() {
  teleop_command_t m{};
  m.device_twist[0] = 0.5;
  m.engaged = 1;
  m.operator_id = "test";
  return m;
}

TEST(CommandCheck, TakesAGoodCommandOver) {
  HumanCommand command;
  ASSERT_EQ(check_command(good_command(), command), nullptr);
  EXPECT_EQ(command.twist[0], 0.5);
  EXPECT_TRUE(command.engaged);
  EXPECT_STREQ(command.operator_id, "test");
}

TEST(CommandCheck, RefusesWhatIsNotFiniteOrOutOfRange) {
  HumanCommand command;
  for (const double bad : std::initializer_list<double>{NAN, INFINITY, -INFINITY, 1.0001, -2.0}) {
    for (int axis = 0; axis < 6; ++axis) {
      teleop_command_t m = good_command();
      m.device_twist[axis] = bad;
      EXPECT_NE(check_command(m, command), nullptr) << axis << " " << bad;
    }
    teleop_command_t m = good_command();
    m.device_gripper = bad;
    EXPECT_NE(check_command(m, command), nullptr);
  }
}

TEST(CommandCheck, RefusesUnknownFlagsAndLongNames) {
  HumanCommand command;
  teleop_command_t m = good_command();
  m.engaged = 2;
  EXPECT_NE(check_command(m, command), nullptr);
  m = good_command();
  m.label = 9;
  EXPECT_NE(check_command(m, command), nullptr);
  m = good_command();
  m.operator_id = std::string(32, 'x');
  EXPECT_NE(check_command(m, command), nullptr);
}

}  // namespace
}  // namespace tandem
