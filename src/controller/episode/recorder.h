#pragma once

#include <atomic>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <tandem/controller_fault_t.hpp>
#include <tandem/controller_status_t.hpp>
#include <tandem/policy_announce_t.hpp>
#include <thread>
#include <vector>

#include "base/spsc_ring.h"
#include "controller/camera/camera_frame.h"
#include "controller/episode/event_log.h"
#include "controller/episode/record.h"
#include "controller/loop/status_board.h"
#include "controller/task/task.h"

namespace tandem {

/// A finished episode as it goes over the wire: what the log holds, byte for byte.
struct FinishedEpisode {
  episode_end_t end;
  std::vector<std::vector<uint8_t>> steps;  ///< encoded EPISODE_STEP, in order
};

struct RecorderSettings {
  double discount = 1.0;       ///< gamma per policy step
  int robot_state_every = 10;  ///< ticks between ROBOT_STATE in the log; 0 = none
  bool every_tick = false;     ///< CONTROL_TICK in the log, for replay of a real-time run
  int64_t env_steps = 0;       ///< training steps that the log already holds
};

/// Where the recorder hands things on to; called on the recorder's thread.
struct RecorderSinks {
  std::function<void(std::shared_ptr<const FinishedEpisode>)> episode;
  std::function<void(const robot_state_t&)> robot_state;
  std::function<void(const action_chunk_t&)> chunk;
  std::function<void(const controller_fault_t&)> fault;
  std::function<controller_status_t()> status;  ///< kept in the log after every real-time episode
  std::function<policy_announce_t(int32_t version)>
      announcement;  ///< of a policy that came into force
};

/// Drains the control thread's ring on its own thread: writes the event log, assembles episodes,
/// computes returns. When the log can't be written any more it asks for the run to stop: nothing is
/// done that would not be recorded.
///
/// What streams while the arm moves (ROBOT_STATE, CONTROL_TICK, WORLD_STATE, TELEOP_COMMAND,
/// ACTION_CHUNK: the motion) is logged for whole episodes, those that begin before the log is
/// full(). All else always is: learning and resuming need it.
class Recorder {
 public:
  /// @param log may be null: episodes are assembled but not written.
  Recorder(SpscRing<Record>& ring, EventLog* log, const TaskSpec& task, int observation_size,
           const RecorderSettings& settings, RecorderSinks sinks, StatusBoard& board);
  ~Recorder();

  /// Camera thread: a frame, before the record of any observation that was made with it.
  void keep(std::shared_ptr<const CameraFrame> frame);

  /// Writes what is still in the ring and ends the thread.
  void stop();

  /// Ends of all episodes since the start; read after stop().
  const std::vector<episode_end_t>& episodes() const { return episodes_; }

 private:
  void run();
  void take(const EpisodeBegin& begin);
  void take(const TickRecord& tick);
  void take(const ObservationRecord& observation);
  void take(const StepSnapshot& snapshot);
  void take(const ChunkRecord& chunk);
  void take(const HumanCommand& command);
  void take(const GainsRecord& gains);
  void take(const StepRecord& step);
  void take(const FaultRecord& fault);
  void take(const EpisodeFinish& finish);
  void take(const PolicyInForce& policy);
  std::shared_ptr<const CameraFrame> frame_of(int32_t step);
  FinishedEpisode assemble(const EpisodeFinish& finish);

  template <typename Message>
  void log(const char* channel, int64_t utime, const Message& message) {
    if (log_) log_->write(channel, utime, message);
  }

  template <typename Message>
  void log_motion(const char* channel, const Message& message) {
    if (keeps_motion_) log(channel, utime_, message);
  }

  SpscRing<Record>& ring_;
  EventLog* log_;
  const TaskSpec& task_;
  const int observation_size_;
  RecorderSettings settings_;
  RecorderSinks sinks_;

  EpisodeBegin episode_;
  bool keeps_motion_ = true;  // of the running episode
  int64_t utime_ = 0;
  std::vector<std::vector<float>> observations_;
  std::vector<std::shared_ptr<const CameraFrame>> images_;  // of the observations; null without
  std::vector<StepRecord> steps_;
  std::deque<TickRecord> last_ticks_;  // what a fault report carries
  std::vector<episode_end_t> episodes_;

  std::mutex mutex_;
  std::deque<std::shared_ptr<const CameraFrame>> frames_;  // not yet asked for; guarded by it

  StatusBoard& board_;
  std::atomic<bool> stopping_{false};
  std::thread thread_;
};

}  // namespace tandem
