#include "controller/link/link.h"

#include <gtest/gtest.h>

#include <cmath>
#include <thread>

namespace tandem {
namespace {

using std::chrono::milliseconds;

/// A network of its own per process, on loopback.
std::string url() {
  return "udpm://239.255.76.67:" + std::to_string(20'000 + getpid() % 20'000) + "?ttl=0";
}

bool eventually(const std::function<bool()>& condition) {
  for (int i = 0; i < 300; ++i) {
    if (condition()) return true;
    std::this_thread::sleep_for(milliseconds(10));
  }
  return false;
}

class LinkTest : public ::testing::Test {
 protected:
  Link::Settings settings_{.url = url(), .learner = true};
  TaskSpec task_;
  StatusBoard board_;
  lcm::LCM peer_{url()};
};

TEST_F(LinkTest, SecondControllerIsRefusedWithASentence) {
  board_.state = controller_status_t::RUNNING;
  Link first(settings_, task_, board_);
  first.start();
  StatusBoard other;
  try {
    Link second(settings_, task_, other);
    FAIL() << "two controllers on one network";
  } catch (const std::runtime_error& error) {
    EXPECT_NE(std::string(error.what()).find("another controller is at work"), std::string::npos);
  }
}

TEST_F(LinkTest, MalformedAndNonFiniteTeleopIsCountedAndNeverReachesTheLoop) {
  Link link(settings_, task_, board_);
  link.start();
  teleop_command_t bad{};
  bad.device_twist[2] = std::nan("");
  peer_.publish("TELEOP_COMMAND", &bad);
  const uint8_t rubbish[] = {1, 2, 3};
  peer_.publish("TELEOP_COMMAND", rubbish, sizeof(rubbish));
  EXPECT_TRUE(eventually([&] { return board_.teleop_rejected == 2; })) << board_.teleop_rejected;
  EXPECT_EQ(link.human_commands().size(), 0u);

  teleop_command_t good{};
  good.engaged = 1;
  peer_.publish("TELEOP_COMMAND", &good);
  EXPECT_TRUE(eventually([&] { return link.human_commands().size() == 1; }));
  EXPECT_EQ(board_.teleop_accepted, 1);
}

TEST_F(LinkTest, EpisodeIsSentUntilAcknowledgedAndAgainOnRequest) {
  Link link(settings_, task_, board_);
  std::atomic<int> ends{0}, steps{0};
  peer_.subscribe<episode_end_t>("EPISODE_END", [&](const lcm::ReceiveBuffer*, const std::string&,
                                                    const episode_end_t*) { ++ends; });
  peer_.subscribeFunction(
      "EPISODE_STEP",
      +[](const lcm::ReceiveBuffer*, const std::string&, std::atomic<int>* count) { ++*count; },
      &steps);
  std::atomic<bool> done{false};
  std::thread listener([&] {
    while (!done) peer_.handleTimeout(20);
  });
  link.start();
  auto episode = std::make_shared<FinishedEpisode>();
  episode->end.episode = 7;
  episode->steps = {{1, 2, 3}, {4, 5, 6}};
  link.send(episode);
  EXPECT_TRUE(eventually([&] { return ends >= 2; }));  // nobody answers: sent again
  EXPECT_EQ(board_.episodes_unacknowledged, 1);

  const int before = steps;
  episode_request_t request{};
  request.episode_requested = 7;
  request.n_missing = 1;
  request.missing_steps = {1};
  peer_.publish("EPISODE_REQUEST", &request);
  EXPECT_TRUE(eventually([&] { return steps > before; }));

  episode_ack_t ack{};
  ack.episode_acknowledged = 7;
  peer_.publish("EPISODE_ACK", &ack);
  EXPECT_TRUE(eventually([&] { return board_.episodes_unacknowledged == 0; }));
  done = true;
  listener.join();
}

TEST_F(LinkTest, RobotStateIsSentAtOnceNotWhenTheThreadNextLooks) {
  Link link(settings_, task_, board_);
  std::atomic<int> received{0};
  peer_.subscribeFunction(
      "ROBOT_STATE",
      +[](const lcm::ReceiveBuffer*, const std::string&, std::atomic<int>* count) { ++*count; },
      &received);
  link.start();
  int64_t shortest_us = 1'000'000;
  for (int i = 1; i <= 20; ++i) {
    std::this_thread::sleep_for(milliseconds(10));  // the thread has gone to sleep for 20 ms
    const int64_t sent_us = monotonic_us();
    link.send(robot_state_t{});
    while (received < i && monotonic_us() - sent_us < 1'000'000) peer_.handleTimeout(1);
    ASSERT_EQ(received, i);
    shortest_us = std::min(shortest_us, monotonic_us() - sent_us);
  }
  EXPECT_LT(shortest_us, 5'000);
}

TEST(Paced, AHundredASecondAllComeThroughThoughEarlyOrLate) {
  Paced<int> paced(9'000);
  int sent = 0;
  for (int i = 0; i < 1000; ++i) {
    const int64_t now_us = 10'000 * (i + 1) + (i % 3 - 1) * 490;  // intervals of 9.02 to 10.49 ms
    const bool due = paced.offer(i, now_us);
    const std::unique_ptr<int> taken = paced.take(now_us);
    EXPECT_TRUE(due && taken && *taken == i);
    sent += taken != nullptr;
  }
  EXPECT_EQ(sent, 1000);
}

TEST(Paced, OfAThousandASecondTheLatestComesThroughEvery9Milliseconds) {
  Paced<int> paced(9'000);
  int sent = 0;
  for (int i = 0; i < 10'000; ++i) {
    const bool due = paced.offer(i, 1000 * i);
    const std::unique_ptr<int> taken = paced.take(1000 * i);
    EXPECT_EQ(due, taken != nullptr);
    if (taken) {
      EXPECT_EQ(*taken, i);
    }
    sent += due;
  }
  EXPECT_EQ(sent, 1112);
  EXPECT_EQ(paced.take(1'000'000'000), nullptr) << "nothing is sent twice";
}

TEST_F(LinkTest, EmergencyStopIsHeardFromAnyone) {
  Link link(settings_, task_, board_);
  link.start();
  controller_command_t order{};
  order.order = controller_command_t::ESTOP;
  peer_.publish("CONTROLLER_COMMAND", &order);
  EXPECT_TRUE(eventually([&] { return board_.estop.load(); }));
  EXPECT_FALSE(board_.stop);  // the arm holds; the run waits for an order
}

TEST_F(LinkTest, OrdersAndGainsThatMakeNoSenseAreRejectedWithTheirReason) {
  settings_.gains.apparent_inertia.setOnes();
  Link link(settings_, task_, board_);
  link.start();
  controller_command_t order{};
  order.order = 77;
  peer_.publish("CONTROLLER_COMMAND", &order);
  EXPECT_TRUE(eventually([&] { return board_.commands_rejected == 1; }));
  impedance_gains_t gains{};
  gains.damping_ratio = 1.0;
  gains.stiffness[0][0] = -5.0;
  peer_.publish("IMPEDANCE_GAINS", &gains);
  EXPECT_TRUE(eventually([&] { return board_.gains_rejected == 1; }));
  EXPECT_NE(board_.last_rejection().find("IMPEDANCE_GAINS"), std::string::npos);
  EXPECT_EQ(link.gains().size(), 0u);
  gains.stiffness[0][0] = 500.0;
  for (double& clip : gains.error_clip_high) clip = 0.01;
  for (double& clip : gains.error_clip_low) clip = 0.01;
  peer_.publish("IMPEDANCE_GAINS", &gains);
  EXPECT_TRUE(eventually([&] { return board_.gains_accepted == 1; }));
  EXPECT_EQ(link.gains().size(), 1u);
}

}  // namespace
}  // namespace tandem
