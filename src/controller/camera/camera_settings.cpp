#include "controller/camera/camera_settings.h"

#include <cctype>

namespace tandem {
namespace {

constexpr size_t kMostViews = 4;

}  // namespace

std::string CameraSettings::channel() const {
  std::string channel = "CAMERA_";
  for (const char c : name)
    channel += static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  return channel;
}

CameraSettings read_camera(Section section) {
  constexpr double kPi = 3.141592653589793;
  CameraSettings settings;
  settings.name = section.text("name");
  settings.views = section.texts("views");
  if (settings.views.empty() || settings.views.size() > kMostViews) {
    throw ScenarioError(section.place("views") + " names " + std::to_string(settings.views.size()) +
                        " cameras; an image has 1 to " + std::to_string(kMostViews) + " views.");
  }
  settings.width = static_cast<int>(section.integer("width_px", 16, 512));
  settings.height = static_cast<int>(section.integer("height_px", 16, 512));
  settings.crop = section.number("crop", 0.1, 1.0);
  settings.jpeg_quality = static_cast<int>(section.integer("jpeg_quality", 10, 100));
  Section jitter = section.section("jitter");
  settings.jitter.light = jitter.number("light", 0.0, 0.9);
  settings.jitter.colour = jitter.number("colour", 0.0, 0.5);
  settings.jitter.position_m = jitter.number("position_m", 0.0, 0.05);
  settings.jitter.angle_rad = jitter.number("angle_deg", 0.0, 20.0) * kPi / 180.0;
  jitter.finish();
  section.finish();
  return settings;
}

}  // namespace tandem
