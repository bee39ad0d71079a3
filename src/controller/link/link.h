#pragma once

#include <atomic>
#include <functional>
#include <lcm/lcm-cpp.hpp>
#include <map>
#include <memory>
#include <mutex>
#include <tandem/controller_command_t.hpp>
#include <tandem/controller_fault_t.hpp>
#include <tandem/episode_ack_t.hpp>
#include <tandem/episode_request_t.hpp>
#include <tandem/impedance_gains_t.hpp>
#include <tandem/learner_status_t.hpp>
#include <tandem/policy_ack_t.hpp>
#include <tandem/policy_announce_t.hpp>
#include <tandem/teleop_command_t.hpp>
#include <thread>
#include <vector>

#include "base/signal.h"
#include "base/spsc_ring.h"
#include "controller/episode/recorder.h"
#include "controller/link/paced.h"
#include "controller/loop/status_board.h"
#include "controller/task/scene.h"
#include "intervention/command_check.h"

namespace tandem {

/// The link thread: all LCM traffic of the controller, in and out.
///
/// The control thread touches only show_world() and the ring of human commands, both wait-free. The
/// recorder and loader threads hand messages over under a mutex that the control thread never
/// takes. A finished episode is sent again every half second until the learner acknowledges it;
/// nothing is forgotten before that.
class Link {
 public:
  struct Settings {
    std::string url;  ///< LCM provider; empty: environment or LCM's default
    bool lockstep = true;
    bool learner = false;  ///< episodes go out and are kept until acknowledged
    int64_t env_steps_budget = 0;
    ImpedanceGains gains = {};  ///< in force at the start; what comes over the wire changes these
  };

  /// Joins the network. @throws std::runtime_error with a sentence when it can't, or when another
  /// controller answers there.
  Link(const Settings& settings, const TaskSpec& task, StatusBoard& board);
  ~Link();

  void on_announcement(std::function<void(const policy_announce_t&)> handler) {
    announced_ = std::move(handler);
  }
  /// Starts the thread; handlers are set by then.
  void start();
  /// Sends what is queued, a last CONTROLLER_STATUS, and ends the thread.
  void stop();

  /// Control thread: WORLD_STATE for the operator. @returns false when the ring is full.
  bool show_world(const StepSnapshot& snapshot) noexcept;
  /// Control thread: checked commands of the human, oldest first.
  SpscRing<HumanCommand>& human_commands() noexcept { return human_commands_; }
  /// Control thread: checked gains, oldest first.
  SpscRing<ImpedanceGains>& gains() noexcept { return gains_; }
  /// Posted after every checked command.
  Signal& human_heard() noexcept { return human_heard_; }

  /// How the controller is now; any thread.
  controller_status_t status() const;

  void send(std::shared_ptr<const FinishedEpisode> episode);
  void send(const robot_state_t& state);
  void send(const action_chunk_t& chunk);
  void send(const policy_ack_t& ack);
  void send(const controller_fault_t& fault);
  /// @param channel CAMERA_<NAME>. For watching only: the newest frame is sent.
  void send(std::shared_ptr<const CameraFrame> frame, const std::string& channel);

 private:
  void run();
  void wake() noexcept;
  void refuse_second_controller();
  void publish_queued();
  void publish_episode(const FinishedEpisode& episode, const std::vector<int32_t>& only_steps);
  void publish_status();

  template <auto kHear>
  lcm::Subscription* subscribe(const char* channel);
  void hear_other(const lcm::ReceiveBuffer* buffer, const std::string&);
  void hear_teleop(const lcm::ReceiveBuffer* buffer, const std::string&);
  void hear_ack(const lcm::ReceiveBuffer* buffer, const std::string& channel);
  void hear_request(const lcm::ReceiveBuffer* buffer, const std::string& channel);
  void hear_announce(const lcm::ReceiveBuffer* buffer, const std::string& channel);
  void hear_learner(const lcm::ReceiveBuffer* buffer, const std::string& channel);
  void reject_learner(const std::string& channel, const std::string& why);
  void hear_command(const lcm::ReceiveBuffer* buffer, const std::string&);
  void hear_gains(const lcm::ReceiveBuffer* buffer, const std::string&);

  Settings settings_;
  const TaskSpec& task_;
  StatusBoard& board_;
  lcm::LCM lcm_;
  const int64_t instance_;
  int wake_fd_;
  bool other_controller_ = false;

  SpscRing<StepSnapshot> world_{16};
  SpscRing<HumanCommand> human_commands_{64};
  SpscRing<ImpedanceGains> gains_{8};
  ImpedanceGains latest_gains_;
  Signal human_heard_;
  std::function<void(const policy_announce_t&)> announced_;

  struct Pending {
    std::shared_ptr<const FinishedEpisode> episode;
    int64_t send_at_us = 0;    ///< next resend
    int64_t answer_at_us = 0;  ///< a request is not answered before
  };
  std::mutex mutex_;  // guards the next seven
  std::map<int64_t, Pending> pending_;
  std::vector<action_chunk_t> chunks_;
  std::vector<policy_ack_t> acks_;
  std::vector<controller_fault_t> faults_;
  std::vector<std::pair<std::string, std::shared_ptr<const CameraFrame>>> frames_;
  Paced<robot_state_t> robot_state_{9'000};  // 100 Hz, which come a little early or late

  int64_t next_status_us_ = 0;
  std::atomic<bool> stopping_{false};
  std::thread thread_;
};

}  // namespace tandem
