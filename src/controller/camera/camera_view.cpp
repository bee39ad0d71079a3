#include "controller/camera/camera_view.h"

#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

#include "base/random.h"
#include "controller/robot/leds.h"

namespace tandem {
namespace {

constexpr int kOversampling = 2;  // pixels drawn for each pixel of the image, an axis
constexpr int kHidden = 5;        // geom group

int state_numbers(const mjModel& model) { return model.nq + 7 * model.nbody; }

void scale(Random& random, double half_width, float* rgb) {
  for (int c = 0; c < 3; ++c) {
    const double factor = 1.0 + random.uniform(-half_width, half_width);
    rgb[c] = std::min(1.0f, static_cast<float>(rgb[c] * factor));
  }
}

Pose pose_of(const double* p, const double* matrix) {
  mjtNum q[4];
  mju_mat2Quat(q, matrix);
  return {Eigen::Vector3d::Map(p), Eigen::Quaterniond(q[0], q[1], q[2], q[3])};
}

}  // namespace

CameraView::CameraView(const Simulation& simulation, const CameraSettings& settings)
    : settings_(settings),
      model_(mj_copyModel(nullptr, simulation.model())),
      nominal_(mj_copyModel(nullptr, simulation.model())),
      data_(mj_makeData(model_.get())) {
  tool_site_ = simulation.site("tool");
  for (const std::string& name : settings.views) {
    const int camera = mj_name2id(model_.get(), mjOBJ_CAMERA, name.c_str());
    if (camera < 0) {
      throw std::runtime_error(simulation.path() + ": the scene has no camera named `" + name +
                               "` (controller.camera.views); those on the hand are `wrist` and"
                               " `wrist_2`.");
    }
    cameras_.push_back(camera);
  }
  if (state_numbers(*model_) > SceneState::kMaxNumbers) {
    throw std::runtime_error(simulation.path() + ": the scene has " +
                             std::to_string(state_numbers(*model_)) +
                             " numbers of positions; a camera can follow " +
                             std::to_string(SceneState::kMaxNumbers) + ". Use fewer bodies.");
  }
  for (const int camera : cameras_) {
    hide_carrier(camera);
    mjtNum& fovy = model_->cam_fovy[camera];  // degrees; less of it is the crop, drawn in full
    fovy = 360.0 / mjPI * std::atan(settings.crop * std::tan(fovy * mjPI / 360.0));
  }
  model_->vis.global.offwidth = kOversampling * settings.width;
  model_->vis.global.offheight = kOversampling * settings.height;
  model_->vis.quality.offsamples = 0;  // the averaging down does it
  mjv_defaultScene(&scene_);
  mjr_defaultContext(&context_);
  mjv_defaultOption(&option_);
  mjv_makeScene(model_.get(), &scene_, 1000);
  mjr_makeContext(model_.get(), &context_, mjFONTSCALE_50);
  mjr_setBuffer(mjFB_OFFSCREEN, &context_);
  for (const int flag : {mjRND_SHADOW, mjRND_REFLECTION, mjRND_SKYBOX, mjRND_HAZE, mjRND_FOG})
    scene_.flags[flag] = 0;
}

CameraView::~CameraView() {
  mjr_freeContext(&context_);
  mjv_freeScene(&scene_);
}

void CameraView::hide_carrier(int camera) {
  const int carrier = model_->cam_bodyid[camera];
  for (int body = model_->body_parentid[carrier]; carrier > 0 && body > 0;
       body = model_->body_parentid[body]) {
    for (int i = 0; i < model_->body_geomnum[body]; ++i)
      model_->geom_group[model_->body_geomadr[body] + i] = kHidden;
  }
}

void CameraView::capture(const Simulation& simulation, SceneState& state) noexcept {
  const mjModel& model = *simulation.model();
  double* to = state.numbers.data();
  mju_copy(to, simulation.data()->qpos, model.nq);
  mju_copy(to + model.nq, model.body_pos, 3 * model.nbody);
  mju_copy(to + model.nq + 3 * model.nbody, model.body_quat, 4 * model.nbody);
}

std::shared_ptr<const CameraFrame> CameraView::frame(const SceneState& state) {
  if (!drawn_ || state.episode_seed != seed_) begin_episode(state.episode_seed);
  pose(state);

  auto frame = std::make_shared<CameraFrame>();
  frame->utime = state.utime;
  frame->episode = state.episode;
  frame->tick = state.tick;
  frame->step = state.step;
  frame->width = settings_.image_width();
  frame->height = settings_.height;
  std::vector<cv::Mat> images;
  for (const int camera : cameras_) {
    const double half_angle = 0.5 * model_->cam_fovy[camera] * mjPI / 180.0;
    const double focal_length = 0.5 * settings_.height / std::tan(half_angle);
    frame->views.push_back({focal_length, camera_in_tool(camera)});
    images.push_back(draw(camera));
  }
  cv::Mat image;
  cv::hconcat(images, image);

  // The policy sees what a reader of the log will see: the pixels of the JPEG.
  cv::imencode(".jpg", image, frame->jpeg, {cv::IMWRITE_JPEG_QUALITY, settings_.jpeg_quality});
  frame->pixels.resize(static_cast<size_t>(3 * frame->width * frame->height));
  cv::Mat rgb(frame->height, frame->width, CV_8UC3, frame->pixels.data());
  cv::cvtColor(cv::imdecode(frame->jpeg, cv::IMREAD_COLOR), rgb, cv::COLOR_BGR2RGB);
  return frame;
}

// Another light, other colours, other mounts.
void CameraView::begin_episode(uint64_t seed) {
  const CameraSettings::Jitter& jitter = settings_.jitter;
  const mjModel& nominal = *nominal_;
  mjModel& model = *model_;
  seed_ = seed;
  drawn_ = true;
  Random random = random_for(seed, Purpose::camera);
  light_leds(nominal_.get(), seed);

  const auto light = [&](float* diffuse, const float* of_scene) {
    const double brightness = 1.0 + random.uniform(-jitter.light, jitter.light);
    for (int c = 0; c < 3; ++c) diffuse[c] = static_cast<float>(of_scene[c] * brightness);
    scale(random, jitter.colour, diffuse);
  };
  light(model.vis.headlight.diffuse, nominal.vis.headlight.diffuse);
  light(model.vis.headlight.ambient, nominal.vis.headlight.ambient);
  for (int i = 0; i < model.nlight; ++i)
    light(model.light_diffuse + 3 * i, nominal.light_diffuse + 3 * i);

  const auto paint = [&](float* rgba, const float* of_scene) {
    std::copy_n(of_scene, 4, rgba);
    scale(random, jitter.colour, rgba);
  };
  for (int i = 0; i < model.nmat; ++i) paint(model.mat_rgba + 4 * i, nominal.mat_rgba + 4 * i);
  for (int i = 0; i < model.ngeom; ++i) {
    // A geom with a material keeps MuJoCo's default colour: any other would replace the material's.
    const float* of_scene = nominal.geom_rgba + 4 * i;
    const bool has_own = model.geom_matid[i] < 0 || of_scene[0] != 0.5f || of_scene[1] != 0.5f ||
                         of_scene[2] != 0.5f;
    if (has_own) paint(model.geom_rgba + 4 * i, of_scene);
  }

  for (const int c : cameras_) {
    Twist change;
    for (int i = 0; i < 3; ++i) change[i] = random.uniform(-jitter.position_m, jitter.position_m);
    for (int i = 3; i < 6; ++i) change[i] = random.uniform(-jitter.angle_rad, jitter.angle_rad);
    const mjtNum* q = nominal.cam_quat + 4 * c;
    const Pose mount = add(
        {Eigen::Vector3d::Map(nominal.cam_pos + 3 * c), Eigen::Quaterniond(q[0], q[1], q[2], q[3])},
        change);
    Eigen::Vector3d::Map(model.cam_pos + 3 * c) = mount.p;
    mjtNum* to = model.cam_quat + 4 * c;
    to[0] = mount.R.w(), to[1] = mount.R.x(), to[2] = mount.R.y(), to[3] = mount.R.z();
  }
}

void CameraView::pose(const SceneState& state) {
  mjModel& model = *model_;
  const double* from = state.numbers.data();
  mju_copy(data_->qpos, from, model.nq);
  mju_copy(model.body_pos, from + model.nq, 3 * model.nbody);
  mju_copy(model.body_quat, from + model.nq + 3 * model.nbody, 4 * model.nbody);
  mj_kinematics(&model, data_.get());
  mj_camlight(&model, data_.get());
}

// BGR, as OpenCV has it.
cv::Mat CameraView::draw(int camera) {
  mjvCamera eye;
  mjv_defaultCamera(&eye);
  eye.type = mjCAMERA_FIXED;
  eye.fixedcamid = camera;
  const mjrRect size{0, 0, kOversampling * settings_.width, kOversampling * settings_.height};
  mjv_updateScene(model_.get(), data_.get(), &option_, nullptr, &eye, mjCAT_ALL, &scene_);
  mjr_render(size, &scene_, &context_);
  cv::Mat rgb(size.height, size.width, CV_8UC3), image;
  mjr_readPixels(rgb.data, nullptr, size, &context_);
  cv::resize(rgb, image, {settings_.width, settings_.height}, 0, 0, cv::INTER_AREA);
  cv::flip(image, image, 0);  // OpenGL begins at the bottom
  cv::cvtColor(image, image, cv::COLOR_RGB2BGR);
  return image;
}

// MuJoCo's camera looks along -z with y up.
Pose CameraView::camera_in_tool(int camera) const {
  const Pose X_WC = pose_of(data_->cam_xpos + 3 * camera, data_->cam_xmat + 9 * camera);
  const Pose X_WE = pose_of(data_->site_xpos + 3 * tool_site_, data_->site_xmat + 9 * tool_site_);
  const Pose turned{Eigen::Vector3d::Zero(), Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0)};
  return inverse(X_WE) * X_WC * turned;
}

}  // namespace tandem
