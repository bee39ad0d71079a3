#include "controller/render/scene_view.h"

#include <cstring>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

#include "controller/render/covers.h"

namespace tandem {
namespace {

constexpr int kFarCovers = 3, kNearCovers = 1, kShapes = 2, kHidden = 5;  // geom groups

std::unique_ptr<Simulation> load(const std::filesystem::path& scene,
                                 const std::filesystem::path& meshes) {
  if (meshes.empty()) return std::make_unique<Simulation>(scene.string());
  const std::string text = with_covers(scene.parent_path() / "../panda/panda.xml", meshes);
  const auto files = std::make_unique<mjVFS>();
  mj_defaultVFS(files.get());
  mj_makeEmptyFileVFS(files.get(), "panda.xml", static_cast<int>(text.size()));
  std::memcpy(files->filedata[mj_findFileVFS(files.get(), "panda.xml")], text.data(), text.size());
  auto simulation = std::make_unique<Simulation>(scene.string(), files.get());
  mj_deleteVFS(files.get());

  // The plain shapes of links and hand would show through the covers.
  mjModel* model = simulation->model();
  for (int geom = 0; geom < model->ngeom; ++geom) {
    const std::string body = mj_id2name(model, mjOBJ_BODY, model->geom_bodyid[geom]);
    if ((body.rfind("link", 0) == 0 || body == "hand") && model->geom_group[geom] == kShapes)
      model->geom_group[geom] = kHidden;
  }
  return simulation;
}

mjvCamera free_camera(const Eigen::Vector3d& look_at, double distance, double azimuth_deg,
                      double elevation_deg) {
  mjvCamera camera;
  mjv_defaultCamera(&camera);
  Eigen::Vector3d::Map(camera.lookat) = look_at;
  camera.distance = distance;
  camera.azimuth = azimuth_deg;
  camera.elevation = elevation_deg;
  return camera;
}

}  // namespace

SceneView::SceneView(const std::filesystem::path& scene, const std::filesystem::path& meshes,
                     int width, int height)
    : width_(width), height_(height), simulation_(load(scene, meshes)) {
  mjModel* model = simulation_->model();
  model->vis.global.offwidth = width;
  model->vis.global.offheight = height;
  mjv_defaultScene(&scene_);
  mjr_defaultContext(&context_);
  mjv_defaultOption(&option_);
  option_.geomgroup[kNearCovers] = option_.geomgroup[kShapes] = 1;
  mjv_makeScene(model, &scene_, 1000);
  mjr_makeContext(model, &context_, mjFONTSCALE_100);
  mjr_setBuffer(mjFB_OFFSCREEN, &context_);
  scene_.flags[mjRND_SHADOW] = scene_.flags[mjRND_REFLECTION] =
      0;  // each is another pass over all meshes
  whole_ = free_camera({0.28, 0.0, 0.36}, 1.4, 130, -14);
  close_ = free_camera({0.5, 0.0, 0.08}, 0.32, 150, -28);
}

SceneView::~SceneView() {
  mjr_freeContext(&context_);
  mjv_freeScene(&scene_);
}

void SceneView::begin(const RecordedEpisode& episode) {
  Simulation& s = *simulation_;
  s.place_site(s.site("goal"), episode.X_WG);
  Eigen::Vector3d::Map(close_.lookat) = episode.X_WG.p + Eigen::Vector3d(0, 0, 0.035);
}

cv::Mat SceneView::draw(const Moment& moment, const ObjectPose& object) {
  Simulation& s = *simulation_;
  s.set_arm(moment.q, moment.gripper_width);
  const int site = s.site("object");
  const bool in_hand = s.is_on_hand(s.model()->site_bodyid[site]);
  s.place_site(site, in_hand ? s.tool_pose() * object.X_EO : object.X_WO);
  s.forward();
  const int side = width_ * 9 / 20;
  cv::Mat picture(height_, width_, CV_8UC3);
  option_.geomgroup[kFarCovers] = 1;
  draw_view(whole_, {0, 0, width_ - side, height_})
      .copyTo(picture(cv::Rect(0, 0, width_ - side, height_)));
  option_.geomgroup[kFarCovers] = 0;  // out of sight, and most of the work
  draw_view(close_, {0, 0, side, height_})
      .copyTo(picture(cv::Rect(width_ - side, 0, side, height_)));
  cv::line(picture, {width_ - side, 0}, {width_ - side, height_}, {255, 255, 255}, 2);
  return picture;
}

cv::Mat SceneView::draw_view(const mjvCamera& camera, const mjrRect& size) {
  mjvCamera view = camera;
  mjv_updateScene(simulation_->model(), simulation_->data(), &option_, nullptr, &view, mjCAT_ALL,
                  &scene_);
  mjr_render(size, &scene_, &context_);
  cv::Mat rgb(size.height, size.width, CV_8UC3), bgr;
  mjr_readPixels(rgb.data, nullptr, size, &context_);
  cv::flip(rgb, rgb, 0);
  cv::cvtColor(rgb, bgr, cv::COLOR_RGB2BGR);
  return bgr;
}

}  // namespace tandem
