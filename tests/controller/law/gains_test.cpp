#include "controller/law/gains.h"

#include <gtest/gtest.h>

#include <fstream>
#include <limits>

#include "controller/law/law_rig.h"

namespace tandem {
namespace {

using namespace testing;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// The `law` section as it stands in config/, with lines of it replaced by others.
Section law_with(const std::map<std::string, std::string>& lines) {
  std::map<std::string, std::string> keys = {{"axes", "base"},
                                             {"stiffness", "[2000, 2000, 2000, 150, 150, 150]"},
                                             {"damping_ratio", "1.0"},
                                             {"apparent_inertia", "[3, 3, 3, 0.06, 0.06, 0.06]"},
                                             {"error_clip", "[0.01, 0.01, 0.01, 0.1, 0.1, 0.1]"},
                                             {"posture", "[0, -0.785, 0, -2.356, 0, 1.571, 0.785]"},
                                             {"posture_stiffness", "10"},
                                             {"posture_torque_limit", "5"}};
  for (const auto& [key, value] : lines) {
    if (value.empty())
      keys.erase(key);
    else
      keys[key] = value;
  }
  const std::string path = ::testing::TempDir() + "law.yaml";
  std::ofstream file(path);
  for (const auto& [key, value] : keys) file << key << ": " << value << "\n";
  file.close();
  return Section::load(path);
}

std::string refusal(const std::map<std::string, std::string>& lines) {
  try {
    read_gains(law_with(lines));
  } catch (const ScenarioError& error) {
    return error.what();
  }
  return "accepted";
}

std::string matrix_text(const Matrix6& matrix) {
  std::ostringstream out;
  out.precision(17);
  for (int i = 0; i < 36; ++i) out << (i ? ", " : "[") << matrix(i / 6, i % 6);
  return out.str() + "]";
}

void expect_says(const std::string& text, const std::string& part) {
  EXPECT_NE(text.find(part), std::string::npos) << text;
}

TEST(Gains, DefaultsAreCriticallyDampedPerAxis) {
  const ImpedanceGains gains = default_gains();
  EXPECT_FALSE(gains.tool_axes);
  EXPECT_EQ(gains.stiffness, Matrix6(six(2000, 150).asDiagonal()));
  const Matrix6 critical = six(2 * std::sqrt(2000 * 3.0), 2 * std::sqrt(150 * 0.06)).asDiagonal();
  EXPECT_LT((gains.damping - critical).cwiseAbs().maxCoeff(), 1e-12);
  EXPECT_EQ(gains.clip_low, six(0.01, 0.1));
  EXPECT_EQ(gains.clip_high, six(0.01, 0.1));
}

TEST(Gains, FullMatrixAndSignsAreRead) {
  Random random{1};
  const Matrix6 K = random_stiffness(random);
  const ImpedanceGains gains =
      read_gains(law_with({{"axes", "tool"},
                           {"stiffness", matrix_text(K)},
                           {"damping_ratio", ""},
                           {"damping", "[10, 11, 12, 1, 2, 3]"},
                           {"error_clip", ""},
                           {"error_clip_low", "[0.002, 0.0016, 0.005, 0.01, 0.025, 0.005]"},
                           {"error_clip_high", "[0.0075, 0.0016, 0.0055, 0.01, 0.025, 0.005]"}}));
  EXPECT_TRUE(gains.tool_axes);
  EXPECT_LT((gains.stiffness - K).norm(), 1e-9);
  EXPECT_EQ(gains.damping(4, 4), 2.0);
  EXPECT_EQ(gains.clip_low[0], 0.002);
  EXPECT_EQ(gains.clip_high[0], 0.0075);
}

TEST(Gains, DampingByRatioIsCriticalInEveryDirectionOfAFullMatrix) {
  Random random{2};
  for (int sample = 0; sample < 200; ++sample) {
    const Matrix6 K = random_stiffness(random);
    const Twist inertia = six(3.0, 0.06);
    const double ratio = random.uniform(0.0, 2.0);
    const Matrix6 D = damping_from_ratio(K, inertia, ratio);
    EXPECT_LT((D - D.transpose()).norm(), 1e-12);
    // In coordinates of unit mass D is 2 ratio times the root of K.
    const Matrix6 scale = inertia.cwiseSqrt().cwiseInverse().asDiagonal();
    const Matrix6 d = scale * D * scale, k = scale * K * scale;
    EXPECT_LT((d * d - 4 * ratio * ratio * k).norm(), 1e-9 * k.norm());
  }
}

TEST(Gains, RefusalsSayValueLimitAndPlace) {
  expect_says(refusal({{"stiffness", "[2000, 2000, 2000, 150, 900, 150]"}}),
              "stiffness is 900 on axis ry; it must be in [0, 600].");
  expect_says(refusal({{"stiffness", "[7000, 2000, 2000, 150, 150, 150]"}}), "7000");
  expect_says(refusal({{"stiffness", "[1, 2]"}}), "has 2 entries");
  Matrix6 K = six(2000, 150).asDiagonal();
  K(0, 2) = 100;
  expect_says(refusal({{"stiffness", matrix_text(K)}}), "not symmetric: 100 at x, z and 0 at z, x");
  K(0, 2) = K(2, 0) = 2500;
  expect_says(refusal({{"stiffness", matrix_text(K)}}),
              "has the eigenvalue -500; all must be >= 0");
  expect_says(refusal({{"damping", "[1, 1, 1, 1, 1, 1]"}}), "says again what `damping_ratio` says");
  expect_says(refusal({{"damping_ratio", ""}}), "damping_ratio is missing");
  expect_says(refusal({{"error_clip_low", "[0, 0, 0, 0, 0, 0]"}}), "says again what `error_clip`");
  expect_says(refusal({{"error_clip", ""}, {"error_clip_low", "[0, 0, 0, 0, 0, 0]"}}),
              "error_clip_high is missing");
  expect_says(refusal({{"axes", "flange"}}), "'flange'");
  expect_says(refusal({{"apparent_inertia", "[3, 3, 3, 0.001, 0.06, 0.06]"},
                       {"damping_ratio", "3"},
                       {"stiffness", "[6000, 6000, 6000, 600, 600, 600]"}}),
              "accepted");
}

class WireGains : public ::testing::Test {
 protected:
  std::string taken() { return gains_from(message, present, gains); }

  const ImpedanceGains present = default_gains();
  ImpedanceGains gains;
  impedance_gains_t message = to_message(present, 5);
};

TEST_F(WireGains, ComeBackAsTheyWereSent) {
  EXPECT_EQ(taken(), "");
  EXPECT_EQ(gains.stiffness, present.stiffness);
  EXPECT_EQ(gains.damping, present.damping);
  EXPECT_EQ(gains.clip_low, present.clip_low);
  EXPECT_EQ(gains.clip_high, present.clip_high);
  EXPECT_EQ(gains.posture, present.posture);
  EXPECT_EQ(message.utime, 5);
}

TEST_F(WireGains, RatioMakesTheDampingFromTheNewStiffness) {
  for (int i = 0; i < 6; ++i) message.stiffness[i][i] = 100.0;
  message.damping_ratio = 0.5;
  EXPECT_EQ(taken(), "");
  EXPECT_NEAR(gains.damping(0, 0), std::sqrt(100.0 * 3.0), 1e-9);
}

TEST_F(WireGains, WhatIsWrongIsSaidAndNothingIsTaken) {
  const impedance_gains_t good = message;
  const auto refused = [&](const std::string& part) {
    gains.posture_stiffness = -1.0;
    expect_says(taken(), part);
    EXPECT_EQ(gains.posture_stiffness, -1.0) << "untouched";
    message = good;
  };
  message.stiffness[1][1] = kNaN;
  refused("stiffness holds a number that is not finite");
  message.stiffness[0][1] = 5.0;
  refused("stiffness is not symmetric");
  message.stiffness[0][0] = -1.0;
  refused("stiffness is -1 on axis x; it must be in [0, 6000]");
  message.stiffness[0][1] = message.stiffness[1][0] = 4000.0;
  refused("stiffness has the eigenvalue -2000");
  message.damping[5][5] = 60.0;
  refused("damping is 60 on axis rz; it must be in [0, 50]");
  message.damping_ratio = kNaN;
  refused("damping_ratio is nan; it must be in [0, 3]");
  message.damping_ratio = 3.5;
  refused("damping_ratio is 3.5");
  message.error_clip_low[3] = -0.1;
  refused("error_clip_low is -0.1 on axis rx");
  message.error_clip_high[3] = kNaN;
  refused("error_clip_high is nan on axis rx; it must be in [0, 0.5]");
  message.tool_axes = 2;
  refused("tool_axes is 2; it must be 0 or 1");
}

TEST_F(WireGains, RandomBytesAreRefusedOrGood) {
  Random random{7};
  int accepted = 0;
  for (int sample = 0; sample < 20000; ++sample) {
    message = to_message(present, 0);
    // A few entries at random, symmetric half of the time.
    for (int n = 0; n < 3; ++n) {
      const int i = random.next() % 6, j = random.next() % 6;
      const uint64_t kind = random.next() % 8;
      const double value = kind == 0   ? kNaN
                           : kind == 1 ? std::numeric_limits<double>::infinity()
                           : kind == 2 ? random.normal(1e300)
                                       : random.normal(kind < 5 ? 3000.0 : 30.0);
      message.stiffness[i][j] = value;
      if (random.next() % 2) message.stiffness[j][i] = value;
      if (random.next() % 8 == 0) message.damping_ratio = random.normal(2.0);
      if (random.next() % 8 == 0) message.error_clip_low[i] = random.normal(0.3);
    }
    if (!taken().empty()) continue;
    ++accepted;
    ASSERT_TRUE(gains.stiffness.allFinite() && gains.damping.allFinite());
    ASSERT_GE(Eigen::SelfAdjointEigenSolver<Matrix6>(gains.stiffness).eigenvalues().minCoeff(),
              -1e-4);
    ASSERT_GE(Eigen::SelfAdjointEigenSolver<Matrix6>(gains.damping).eigenvalues().minCoeff(),
              -1e-4);
    ASSERT_GE(gains.clip_low.minCoeff(), 0.0);
  }
  EXPECT_GT(accepted, 100);
}

}  // namespace
}  // namespace tandem
