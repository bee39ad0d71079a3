// tandem_render: episodes of an event log as a video.

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <filesystem>

#include "controller/render/covers.h"
#include "controller/render/overlay.h"
#include "controller/render/recording.h"
#include "controller/render/scene_view.h"
#include "controller/render/video.h"
#include "controller/task/task.h"

namespace tandem {
namespace {

struct Settings {
  std::string log, video, root = ".", meshes = "auto";
  int episodes = 5, width = 1024, height = 512;
  double fps = 15.0;
};

constexpr double kFreeze = 0.8;  // s, the last picture of an episode stays

void render(const Settings& settings) {
  const auto began = std::chrono::steady_clock::now();
  const auto seconds = [&] {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count();
  };
  const Recording recording = read_recording(settings.log, settings.episodes);
  const std::filesystem::path root(settings.root);
  const std::filesystem::path meshes = settings.meshes == "auto" ? find_covers(root)
                                       : settings.meshes == "none"
                                           ? std::filesystem::path()
                                           : std::filesystem::path(settings.meshes);
  SceneView view(root / recording.scene, meshes, settings.width, settings.height);
  const std::unique_ptr<Task> task =
      make_task(Section::parse(recording.scenario, settings.log).section("task"));
  task->attach(view.simulation());
  Video video(settings.video, settings.width, settings.height, settings.fps);
  const double loaded = seconds();

  int frames = 0;
  const double step = 1000.0 / settings.fps;  // ticks
  for (const RecordedEpisode& episode : recording.episodes) {
    task->stage(view.simulation(), episode.seed);
    view.begin(episode);
    const double first = static_cast<double>(episode.moments.front().tick),
                 last = static_cast<double>(episode.moments.back().tick);
    for (double tick = first; tick < last; tick += step, ++frames) {
      const Moment moment = episode.at(tick);
      cv::Mat picture = view.draw(moment, episode.object_at(tick));
      draw_overlay(picture, episode, moment, false);
      video.write(picture);
    }
    cv::Mat picture = view.draw(episode.moments.back(), episode.object_at(last));
    draw_overlay(picture, episode, episode.moments.back(), true);
    for (int i = 0; i < kFreeze * settings.fps; ++i, ++frames) video.write(picture);
  }
  video.close();
  std::printf(
      "%s: %zu episodes, %d pictures, %.1f s of video (%s); loading %.1f s, %.1f ms a picture.\n",
      settings.video.c_str(), recording.episodes.size(), frames, frames / settings.fps,
      video.codec(), loaded, 1e3 * (seconds() - loaded) / frames);
}

}  // namespace
}  // namespace tandem

int main(int argc, char** argv) {
  tandem::Settings settings;
  CLI::App app("Draws the last episodes of an event log (LCM) as a video, in the log's own time.");
  app.add_option("log", settings.log, "event log that tandem_controller wrote")->required();
  app.add_option("video", settings.video, "file to write, .mp4")->required();
  app.add_option("--episodes", settings.episodes, "how many, counted from the end of the log")
      ->check(CLI::Range(1, 10000))
      ->capture_default_str();
  app.add_option("--width", settings.width, "pixels, even")
      ->check(CLI::Range(160, 3840))
      ->capture_default_str();
  app.add_option("--height", settings.height, "pixels, even")
      ->check(CLI::Range(120, 2160))
      ->capture_default_str();
  app.add_option("--fps", settings.fps, "pictures per second of simulated time")
      ->check(CLI::Range(1.0, 100.0))
      ->capture_default_str();
  app.add_option("--meshes", settings.meshes,
                 "folder of the arm's meshes (link*.obj), or none; auto: those of gym-hil in .venv")
      ->capture_default_str();
  app.add_option("--root", settings.root, "root of the checkout, where models/ lies")
      ->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  settings.width &= ~1;  // H.264 wants even sizes
  settings.height &= ~1;
  try {
    tandem::render(settings);
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 2;
  }
}
