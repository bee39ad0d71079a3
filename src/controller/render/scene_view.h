#pragma once

#include <filesystem>
#include <memory>
#include <opencv2/core.hpp>
#include <string>

#include "controller/render/egl_context.h"
#include "controller/render/recording.h"
#include "controller/robot/simulation.h"

namespace tandem {

/// Pictures of a scene: the whole arm, and large beside it what happens at the tip of the tool.
class SceneView {
 public:
  /// Size in pixels. `meshes`: folder of the arm's covers, or empty for plain shapes.
  /// @throws std::runtime_error with a sentence if scene or meshes cannot be loaded or there is no
  /// EGL.
  SceneView(const std::filesystem::path& scene, const std::filesystem::path& meshes, int width,
            int height);
  ~SceneView();

  /// Puts the goal of an episode in its place: the body of the scene's site `goal`.
  void begin(const RecordedEpisode& episode);

  /// BGR, 8 bit. The body of the scene's site `object` is where it was: in the hand when it is
  /// fixed to it, else in the world.
  cv::Mat draw(const Moment& moment, const ObjectPose& object);

  Simulation& simulation() { return *simulation_; }

 private:
  cv::Mat draw_view(const mjvCamera& camera, const mjrRect& size);

  int width_, height_;
  std::unique_ptr<Simulation> simulation_;
  EglContext egl_;
  mjvScene scene_;
  mjrContext context_;
  mjvOption option_;
  mjvCamera whole_, close_;
  cv::Mat pixels_;
};

}  // namespace tandem
