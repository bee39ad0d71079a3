#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <thread>

#include "base/signal.h"
#include "base/spsc_ring.h"
#include "controller/camera/camera_frame.h"
#include "controller/camera/camera_settings.h"
#include "controller/loop/status_board.h"
#include "controller/robot/simulation.h"
#include "controller/task/scene.h"

namespace tandem {

/// The camera thread: one frame for every step. The control thread hands the scene's state over and
/// never waits; the policy thread takes the frame that its observation is made with.
class CameraWorker {
 public:
  /// Called on the camera thread with every frame, before the policy can see it.
  using Sink = std::function<void(std::shared_ptr<const CameraFrame>)>;

  /// Draws a first image, so that nothing is compiled in the loop. `simulation` must outlive this.
  /// @throws std::runtime_error as CameraView does.
  CameraWorker(const Simulation& simulation, const CameraSettings& settings, bool lockstep,
               Sink sink, StatusBoard& board);
  ~CameraWorker();

  /// Control thread, when a step begins. @returns false when the camera lags by a whole ring.
  bool ask(const StepSnapshot& snapshot) noexcept;

  /// Policy thread: the frame to be seen at this step. In lockstep that of the step itself. In real
  /// time it is waited for no longer than kPatience; then the newest of this episode will do, and
  /// is counted as late. Null when there is none.
  std::shared_ptr<const CameraFrame> frame(const StepSnapshot& snapshot) noexcept;

  static constexpr std::chrono::milliseconds kPatience{40};

 private:
  void run(const CameraSettings& settings);
  void take_new(const StepSnapshot& snapshot) noexcept;

  const Simulation& simulation_;
  const bool lockstep_;
  Sink sink_;
  StatusBoard& board_;
  SpscRing<SceneState> states_{16};
  SpscRing<std::shared_ptr<const CameraFrame>> frames_{64};
  Signal asked_, drawn_, started_;
  std::shared_ptr<const CameraFrame> newest_;  // the policy thread's
  std::exception_ptr failure_;                 // of the start
  std::atomic<bool> stopping_{false};
  std::thread thread_;
};

}  // namespace tandem
