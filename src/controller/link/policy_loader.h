#pragma once

#include <condition_variable>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <tandem/policy_ack_t.hpp>
#include <tandem/policy_announce_t.hpp>
#include <thread>

#include "controller/task/task.h"
#include "policy_runtime/slot/policy_slot.h"

namespace tandem {

/// Loads and checks a policy for this task: digest, structure, golden examples, observation and
/// action names, horizon.
/// @param sha256 expected digest of the file, empty to skip. @param horizon what the scenario says,
/// 0 to skip. @param cameras that the arm has; a policy may look through no others.
/// @throws std::runtime_error with a sentence
std::unique_ptr<const policy::Policy> load_policy(const std::string& path,
                                                  const std::string& sha256, const Task& task,
                                                  int horizon,
                                                  const std::vector<policy::Camera>& cameras = {});

/// The loader thread: turns announcements into policies in the slot, at low priority.
///
/// In real time a policy comes into force as soon as it is verified. In lockstep it waits until the
/// control side asks for exactly the one that was trained through a certain episode, so that a run
/// does not depend on who is faster.
class PolicyLoader {
 public:
  struct Settings {
    std::string run_folder;  ///< paths in announcements are relative to it
    int horizon = 0;
    bool lockstep = true;
    std::vector<policy::Camera> cameras = {};
  };

  PolicyLoader(policy::PolicySlot& slot, const Task& task, Settings settings,
               std::function<void(const policy_ack_t&)> acknowledge);
  ~PolicyLoader();

  /// From the network, any thread. A repeated announcement is acknowledged again and otherwise
  /// ignored.
  void announce(const policy_announce_t& announcement);

  /// Lockstep, between episodes: waits until the policy trained through `episode` is in the slot.
  /// @returns its version, or 0 when `timeout` passed first; refusal() then says whether one was
  /// refused.
  int32_t put_in_force(int64_t episode, std::chrono::milliseconds timeout);

  /// Version that was put in the slot last, 0 = none yet.
  int32_t version_in_force() const;

  /// The newest announcement of a version; empty fields when unknown.
  policy_announce_t announcement(int32_t version) const;

  /// Sentence about the newest announced policy when it was refused, else empty.
  std::string refusal() const;
  int64_t refused_count() const;

 private:
  static constexpr int64_t kNothing = -2;
  struct Loaded {
    policy_announce_t announcement;
    std::unique_ptr<const policy::Policy> policy;
  };
  void run();
  void load(const policy_announce_t& announcement);

  policy::PolicySlot& slot_;
  const Task& task_;
  Settings settings_;
  std::function<void(const policy_ack_t&)> acknowledge_;

  mutable std::mutex mutex_;
  std::condition_variable work_, done_;
  std::deque<policy_announce_t> queue_;
  std::map<int32_t, policy_announce_t> announced_;
  std::map<int32_t, policy_ack_t> answered_;
  std::map<int64_t, Loaded> ready_;  // by episodes_trained_through
  int64_t wanted_ = kNothing;        // episodes_trained_through that the control side asks for
  policy_announce_t in_force_;       // of what was put in the slot last
  std::string refusal_;
  int64_t refused_count_ = 0;
  int32_t newest_version_ = 0;
  bool stopping_ = false;
  std::thread thread_;
};

}  // namespace tandem
