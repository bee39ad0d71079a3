#pragma once

#include <atomic>
#include <thread>

#include "base/signal.h"
#include "base/spsc_ring.h"
#include "controller/camera/camera_worker.h"
#include "controller/chunk/chunk.h"
#include "controller/episode/record.h"
#include "controller/task/task.h"
#include "policy_runtime/slot/policy_slot.h"

namespace tandem {

/// What the policy thread made of a snapshot.
struct PolicyAnswer {
  ObservationRecord observation;
  bool has_chunk = false;
  Chunk chunk;
};

/// The policy thread: builds the observation of every step and, when an inference is due, evaluates
/// the policy in force. Both directions are wait-free for the control thread.
class PolicyWorker {
 public:
  /// @param priority SCHED_FIFO, below the control thread's; 0 = like any other thread.
  /// @param camera what the policy looks through; null: it doesn't.
  PolicyWorker(const Task& task, policy::PolicySlot& slot, int priority = 0,
               CameraWorker* camera = nullptr);
  ~PolicyWorker();

  /// Control thread, at the start of a step. @returns false when the worker lags by a whole ring.
  bool ask(const StepSnapshot& snapshot) noexcept;

  /// Control thread: oldest answer or null; pop_answer() lets go of it.
  PolicyAnswer* answer() noexcept { return answers_.front(); }
  void pop_answer() noexcept { answers_.pop(); }

  /// Posted after every answer; lockstep waits on it.
  Signal& answered() noexcept { return answered_; }

 private:
  void run() noexcept;
  void infer(const StepSnapshot& snapshot, const CameraFrame* frame, PolicyAnswer& answer) noexcept;

  const Task& task_;
  policy::PolicySlot& slot_;
  CameraWorker* camera_;
  SpscRing<StepSnapshot> questions_{16};
  SpscRing<PolicyAnswer> answers_{16};
  Signal asked_, answered_;
  std::atomic<bool> stopping_{false};
  std::array<int, 7> axis_of_output_{};
  std::array<float, kMaxHorizon * 7> output_{};
  std::thread thread_;
};

}  // namespace tandem
