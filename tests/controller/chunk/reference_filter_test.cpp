#include "controller/chunk/reference_filter.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "base/random.h"

namespace tandem {
namespace {

constexpr double kDt = 0.001;

const ReferenceSettings kSettings = [] {
  Section controller = Section::load(std::string(TANDEM_ROOT) + "/config/controller.yaml");
  return read_reference(controller.section("reference"));
}();

Twist random_twist(Random& random, double linear, double angular) {
  Twist twist;
  for (int i = 0; i < 6; ++i) twist[i] = random.uniform(-1, 1) * (i < 3 ? linear : angular);
  return twist;
}

/// Largest of what a reference did from tick to tick, measured on its poses alone.
class Watch {
 public:
  explicit Watch(const Pose& start) : before_(start) {}

  void see(const Pose& now) {
    const Twist velocity = minus(now, before_) / kDt;
    const Twist acceleration = (velocity - velocity_) / kDt;
    linear_velocity = std::max(linear_velocity, velocity.head<3>().norm());
    angular_velocity = std::max(angular_velocity, velocity.tail<3>().norm());
    linear_acceleration = std::max(linear_acceleration, acceleration.head<3>().norm());
    angular_acceleration = std::max(angular_acceleration, acceleration.tail<3>().norm());
    before_ = now;
    velocity_ = velocity;
  }

  void expect_within_limits() const {
    // A jump of 0.5 mm and 5 mrad a tick is 0.5 m/s and 5 rad/s. Differences of rounded poses
    // carry some 1e-13 / dt^2.
    EXPECT_LE(linear_velocity, std::min(0.5, kSettings.velocity_linear) + 1e-9);
    EXPECT_LE(angular_velocity, std::min(5.0, kSettings.velocity_angular) + 1e-9);
    EXPECT_LE(linear_acceleration, kSettings.acceleration_linear + 1e-6);
    EXPECT_LE(angular_acceleration, kSettings.acceleration_angular + 1e-6);
  }

  double linear_velocity = 0.0, angular_velocity = 0.0;
  double linear_acceleration = 0.0, angular_acceleration = 0.0;

 private:
  Pose before_;
  Twist velocity_ = Twist::Zero();
};

TEST(ReferenceFilter, WhateverIsCommandedItIsContinuousInPoseAndVelocity) {
  // Ramps that change at random times, and jumps: 200 x 2000 ticks.
  double fastest = 0.0, hardest = 0.0;
  for (uint64_t seed = 0; seed < 200; ++seed) {
    Random random{5, seed};
    ReferenceFilter f(kSettings);
    Pose commanded = add(Pose{}, random_twist(random, 0.5, 1.5));
    f.reset(commanded);
    Watch watch(commanded);
    Twist velocity = Twist::Zero();
    for (int tick = 0; tick < 2000; ++tick) {
      if (random.uniform(0, 1) < 0.02) velocity = random_twist(random, 0.3, 2.0);
      if (random.uniform(0, 1) < 0.002) {
        commanded = add(commanded, random_twist(random, 0.2, 1.0));
      }
      commanded = add(commanded, kDt * velocity);
      watch.see(f.step(commanded).X_WE);
    }
    watch.expect_within_limits();
    fastest = std::max(fastest, watch.linear_velocity);
    hardest = std::max(hardest, watch.angular_acceleration);
  }
  // The limits were really reached.
  EXPECT_NEAR(fastest, kSettings.velocity_linear, 1e-6);
  EXPECT_NEAR(hardest, kSettings.acceleration_angular, 1e-3);
}

TEST(ReferenceFilter, FeedForwardIsTheVelocityOfThePose) {
  ReferenceFilter f(kSettings);
  Pose commanded;
  f.reset(commanded);
  Random random{9};
  Twist velocity = Twist::Zero();
  for (int tick = 0; tick < 5000; ++tick) {
    if (tick % 100 == 0) velocity = random_twist(random, 0.12, 1.0);
    commanded = add(commanded, kDt * velocity);
    const Pose before = f.reference().X_WE;
    const PoseReference& now = f.step(commanded);
    ASSERT_LE((minus(now.X_WE, before) / kDt - now.V_WE).norm(), 1e-9);
  }
}

TEST(ReferenceFilter, NothingIsCutInTheMotionsThatATaskCanAskFor) {
  // Full reversals of every axis of the peg task at once, the worst that actions can do.
  ReferenceFilter f(kSettings);
  Pose commanded;
  f.reset(commanded);
  Watch watch(commanded);
  Twist velocity;
  velocity << 0.12, 0.12, 0.12, 0.0, 0.0, 1.0;
  for (int tick = 0; tick < 4000; ++tick) {
    if (tick % 200 == 0) velocity = -velocity;
    commanded = add(commanded, kDt * velocity);
    watch.see(f.step(commanded).X_WE);
  }
  EXPECT_LT(watch.linear_velocity, kSettings.velocity_linear);
  EXPECT_LT(watch.angular_velocity, kSettings.velocity_angular);
  EXPECT_LT(watch.linear_acceleration, kSettings.acceleration_linear);
  EXPECT_LT(watch.angular_acceleration, kSettings.acceleration_angular);
}

TEST(ReferenceFilter, ReachesAnyPoseAtRestStraightAndWithoutOvershoot) {
  for (uint64_t seed = 0; seed < 100; ++seed) {
    Random random{11, seed};
    const double scale = std::pow(10.0, random.uniform(-4, 0));  // 0.1 mm ... 1 m
    ReferenceFilter f(kSettings);
    f.reset(Pose{});
    const Pose commanded = add(Pose{}, scale * random_twist(random, 1.0, 1.0));
    const Eigen::Vector3d way = commanded.p, axis = log_map(commanded.R);
    for (int tick = 0; tick < 4000; ++tick) {
      const Pose& X = f.step(commanded).X_WE;
      ASSERT_LE(X.p.dot(way), way.squaredNorm() * (1.0 + 1e-9));
      ASSERT_LE(X.p.cross(way).norm(), 1e-9);
      ASSERT_LE(log_map(X.R).dot(axis), axis.squaredNorm() * (1.0 + 1e-9));
    }
    EXPECT_LE(minus(commanded, f.reference().X_WE).norm(), 1e-9);
    EXPECT_LE(f.reference().V_WE.norm(), 1e-7);
  }
}

TEST(ReferenceFilter, LagsASteadyRampByTwoOverOmega) {
  ReferenceFilter f(kSettings);
  Pose commanded;
  f.reset(commanded);
  for (int tick = 0; tick < 1000; ++tick) {
    commanded.p.x() += kDt * 0.1;
    f.step(commanded);
  }
  EXPECT_NEAR(commanded.p.x() - f.reference().X_WE.p.x(), 0.1 * 2.0 / kSettings.omega, 1e-4);
  EXPECT_NEAR(f.reference().V_WE[0], 0.1, 1e-6);
}

TEST(ReferenceFilter, ResetReAnchorsAndKeepsNoVelocity) {
  ReferenceFilter f(kSettings);
  f.reset(Pose{});
  Pose ahead;
  ahead.p.x() = 0.1;
  for (int tick = 0; tick < 20; ++tick) f.step(ahead);
  Pose elsewhere;
  elsewhere.p.y() = 0.3;
  f.reset(elsewhere);
  EXPECT_EQ(f.reference().V_WE, Twist::Zero());
  f.step(elsewhere);
  EXPECT_EQ(f.reference().X_WE.p, elsewhere.p);
  EXPECT_EQ(f.reference().V_WE, Twist::Zero());
}

}  // namespace
}  // namespace tandem
