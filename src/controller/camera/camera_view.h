#pragma once

#include <mujoco/mujoco.h>

#include <memory>
#include <opencv2/core.hpp>
#include <vector>

#include "controller/camera/camera_frame.h"
#include "controller/camera/camera_settings.h"
#include "controller/render/egl_context.h"
#include "controller/robot/simulation.h"

namespace tandem {

/// The images of the cameras of a scene, drawn from a model and data of its own.
///
/// Drawn at twice the size and averaged down, without shadows and reflections, and without the
/// links that carry the cameras, which they can't see. Light, colours and mounts are drawn anew for
/// each episode from its seed. The same state and seed give the same bytes, whatever was drawn
/// before.
///
/// Of one thread: that of its construction.
class CameraView {
 public:
  /// Copies the scene as the task has shaped it. @throws std::runtime_error with a sentence when
  /// there is no such camera, the scene is too large or there is no EGL.
  CameraView(const Simulation& simulation, const CameraSettings& settings);
  ~CameraView();
  CameraView(const CameraView&) = delete;
  CameraView& operator=(const CameraView&) = delete;

  /// How the simulation stands now. Real-time; for the thread that the simulation belongs to.
  static void capture(const Simulation& simulation, SceneState& state) noexcept;

  std::shared_ptr<const CameraFrame> frame(const SceneState& state);

 private:
  struct FreeModel {
    void operator()(mjModel* model) const { mj_deleteModel(model); }
  };
  struct FreeData {
    void operator()(mjData* data) const { mj_deleteData(data); }
  };

  void hide_carrier(int camera);
  void begin_episode(uint64_t seed);
  void pose(const SceneState& state);
  cv::Mat draw(int camera);
  Pose camera_in_tool(int camera) const;

  CameraSettings settings_;
  EglContext egl_;
  std::unique_ptr<mjModel, FreeModel> model_, nominal_;  // jittered, and as the scene has it
  std::unique_ptr<mjData, FreeData> data_;
  mjvScene scene_;
  mjrContext context_;
  mjvOption option_;
  std::vector<int> cameras_;  // of the model, from left to right
  int tool_site_ = -1;
  bool drawn_ = false;
  uint64_t seed_ = 0;
};

}  // namespace tandem
