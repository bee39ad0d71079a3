#include "controller/link/policy_loader.h"

#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <stdexcept>

#include "base/sha256.h"
#include "base/signal.h"

namespace tandem {
namespace {

// What is not a regular file may never end; what is long may be anything.
constexpr uintmax_t kLargestFile = 1u << 30;

// Announcements kept for those who ask again; more are a flood.
constexpr size_t kRemembered = 1000, kQueued = 64;

std::string file_digest(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file)
    throw std::runtime_error(
        path + ": the policy file can't be read; check the path and its permissions.");
  Sha256 digest;
  char block[65536];
  while (file.read(block, sizeof(block)) || file.gcount() > 0)
    digest.add(block, static_cast<size_t>(file.gcount()));
  return digest.hex();
}

std::string join(const std::vector<std::string>& names) {
  std::string text;
  for (const std::string& name : names) text += (text.empty() ? "" : " ") + name;
  return text;
}

std::string list(const std::vector<policy::Camera>& cameras) {
  std::string text;
  for (const policy::Camera& camera : cameras) {
    text += (text.empty() ? "" : ", ") + camera.name + " (" + std::to_string(camera.width) + " x " +
            std::to_string(camera.height) + " px)";
  }
  return text.empty() ? "no camera" : text;
}

}  // namespace

std::unique_ptr<const policy::Policy> load_policy(const std::string& path,
                                                  const std::string& sha256, const Task& task,
                                                  int horizon,
                                                  const std::vector<policy::Camera>& cameras) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error) ||
      std::filesystem::file_size(path, error) > kLargestFile) {
    throw std::runtime_error(path + ": this is not a regular file of at most 1 GiB" +
                             (error ? " (" + error.message() + ")" : "") +
                             "; a policy file is needed here.");
  }
  if (!sha256.empty() && file_digest(path) != sha256) {
    throw std::runtime_error(
        path +
        ": the file's SHA-256 is not the announced one; it was changed or cut after it was "
        "written, announce it again.");
  }
  auto policy = policy::Policy::load(path);
  const policy::Header& header = policy->header();
  if (header.task != task.spec().name) {
    throw std::runtime_error(path + ": this policy is for the task '" + header.task +
                             "', not for '" + task.spec().name + "'; give --task " + header.task +
                             " or another policy.");
  }
  if (header.observation_names != task.observation().names()) {
    throw std::runtime_error(path + ": the policy was trained on the observation [" +
                             join(header.observation_names) + "], the task gives [" +
                             join(task.observation().names()) +
                             "]; use the scenario that it "
                             "was trained with.");
  }
  if (header.action_axes != task.spec().action_axes) {
    throw std::runtime_error(path + ": the policy moves the axes [" + join(header.action_axes) +
                             "], the task [" + join(task.spec().action_axes) +
                             "]; use the scenario that it was trained with.");
  }
  if (!policy->cameras().empty() && policy->cameras() != cameras) {
    throw std::runtime_error(path + ": the policy looks through " + list(policy->cameras()) +
                             ", the arm has " + list(cameras) +
                             "; use run.observe and controller.camera as it was trained with.");
  }
  if (header.horizon > kMaxHorizon || (horizon > 0 && header.horizon != horizon)) {
    throw std::runtime_error(path + ": the policy's chunks have " + std::to_string(header.horizon) +
                             " steps; the scenario's method.horizon is " + std::to_string(horizon) +
                             " (at most " + std::to_string(kMaxHorizon) + ").");
  }
  return policy;
}

PolicyLoader::PolicyLoader(policy::PolicySlot& slot, const Task& task, Settings settings,
                           std::function<void(const policy_ack_t&)> acknowledge)
    : slot_(slot),
      task_(task),
      settings_(std::move(settings)),
      acknowledge_(std::move(acknowledge)) {
  in_force_.version = 0;
  in_force_.episodes_trained_through = kNothing;
  thread_ = std::thread([this] { run(); });
}

PolicyLoader::~PolicyLoader() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  work_.notify_one();
  thread_.join();
}

void PolicyLoader::announce(const policy_announce_t& announcement) {
  std::unique_lock lock(mutex_);
  const auto answered = answered_.find(announcement.version);
  if (answered != answered_.end() &&
      announced_[announcement.version].sha256 == announcement.sha256) {
    const policy_ack_t again = answered->second;
    lock.unlock();
    acknowledge_(again);
    return;
  }
  for (const policy_announce_t& queued : queue_) {
    if (queued.version == announcement.version) return;
  }
  if (queue_.size() == kQueued) return;  // it is announced again until it is answered
  queue_.push_back(announcement);
  lock.unlock();
  work_.notify_one();
}

int32_t PolicyLoader::put_in_force(int64_t episode, std::chrono::milliseconds timeout) {
  std::unique_lock lock(mutex_);
  wanted_ = episode;
  work_.notify_one();
  const bool there =
      done_.wait_for(lock, timeout, [&] { return in_force_.episodes_trained_through == episode; });
  return there ? in_force_.version : 0;
}

int32_t PolicyLoader::version_in_force() const {
  const std::lock_guard lock(mutex_);
  return in_force_.version;
}

policy_announce_t PolicyLoader::announcement(int32_t version) const {
  const std::lock_guard lock(mutex_);
  const auto found = announced_.find(version);
  return found == announced_.end() ? policy_announce_t{} : found->second;
}

std::string PolicyLoader::refusal() const {
  const std::lock_guard lock(mutex_);
  return refusal_;
}

int64_t PolicyLoader::refused_count() const {
  const std::lock_guard lock(mutex_);
  return refused_count_;
}

void PolicyLoader::run() {
  // This thread yields to everything else; a failure to lower its priority changes nothing but
  // that.
  setpriority(PRIO_PROCESS, static_cast<id_t>(syscall(SYS_gettid)), 5);
  std::unique_lock lock(mutex_);
  while (!stopping_) {
    if (!queue_.empty()) {
      const policy_announce_t announcement = queue_.front();
      lock.unlock();
      load(announcement);
      lock.lock();
      queue_.pop_front();
      continue;
    }
    if (const auto found = ready_.find(wanted_); found != ready_.end()) {
      // Older ones can't be asked for any more.
      Loaded chosen = std::move(found->second);
      ready_.erase(ready_.begin(), std::next(found));
      in_force_ = chosen.announcement;
      slot_.publish(std::move(chosen.policy));
      done_.notify_all();
      continue;
    }
    work_.wait(lock);
  }
}

void PolicyLoader::load(const policy_announce_t& announcement) {
  policy_ack_t ack;
  ack.utime = monotonic_us();
  ack.version_answered = announcement.version;
  ack.accepted = 0;
  ack.parity_error = 0.0;
  ack.wall_load_us = ack.wall_inference_us = 0;
  std::unique_ptr<const policy::Policy> policy;
  const int64_t start_us = monotonic_us();
  try {
    const std::filesystem::path path =
        std::filesystem::path(settings_.run_folder) / announcement.path;
    policy = load_policy(path.string(), announcement.sha256, task_, settings_.horizon,
                         settings_.cameras);
    if (policy->header().version != announcement.version) {
      throw std::runtime_error(path.string() + ": the file holds version " +
                               std::to_string(policy->header().version) + ", announced was " +
                               std::to_string(announcement.version) + ".");
    }
    ack.accepted = 1;
    ack.parity_error = policy->golden_error();
    ack.wall_load_us = static_cast<int32_t>(monotonic_us() - start_us);

    policy::Workspace workspace = policy->make_workspace();
    const std::vector<float> observation(static_cast<size_t>(policy->header().observation_size()),
                                         0.1f);
    std::vector<float> chunk(static_cast<size_t>(policy->header().chunk_size()));
    const int64_t inference_start_us = monotonic_us();
    constexpr int kRuns = 16;
    for (int i = 0; i < kRuns; ++i)
      (void)policy->forward({.observation = observation.data()}, chunk.data(), workspace);
    ack.wall_inference_us = static_cast<int32_t>((monotonic_us() - inference_start_us) / kRuns);
  } catch (const std::exception& error) {
    ack.reason = error.what();
  }

  {
    const std::lock_guard lock(mutex_);
    answered_[announcement.version] = ack;
    announced_[announcement.version] = announcement;
    if (answered_.size() > kRemembered) answered_.erase(answered_.begin());
    if (announced_.size() > kRemembered) announced_.erase(announced_.begin());
    if (announcement.version >= newest_version_) {
      newest_version_ = announcement.version;
      refusal_ = ack.reason;
    }
    if (!ack.accepted) {
      ++refused_count_;
    } else if (settings_.lockstep) {
      ready_[announcement.episodes_trained_through] = {announcement, std::move(policy)};
    } else {
      slot_.publish(std::move(policy));
      in_force_ = announcement;
    }
  }
  acknowledge_(ack);
}

}  // namespace tandem
