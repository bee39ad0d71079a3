/// How well the arm follows commands in free space, and what two choices of the controller are
/// worth:
///
///   ours             increments move one commanded pose; rotation error by the log map
///   measured anchor  each 10 Hz command starts from the measured pose, as in many systems
///   half rotation    rotation error from the quaternion's vector part, as in SERL's controller:
///                    for the same number in the settings half the stiffness
///
/// All three run the same commands through the same executor, reference, law, safety filter and
/// simulated robot; once in free motion and once with a load that the robot's gravity compensation
/// does not know, 100 mm beside the tool. Simulated and deterministic: the same numbers on every
/// machine.
///
///   ./build/bin/tandem_bench_tracking [--load N] [--json FILE]     from the root of the tree

#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <utility>

#include "tracking_run.h"

namespace tandem::bench {
namespace {

nlohmann::json to_json(const Tracking& t) {
  return {{"position_mm",
           {{"rms", 1e3 * t.position_rms},
            {"max", 1e3 * t.position_max},
            {"steady", 1e3 * t.position_steady},
            {"delayed_rms", 1e3 * t.delayed_position_rms}}},
          {"rotation_mrad",
           {{"rms", 1e3 * t.rotation_rms},
            {"max", 1e3 * t.rotation_max},
            {"steady", 1e3 * t.rotation_steady},
            {"delayed_rms", 1e3 * t.delayed_rotation_rms}}}};
}

int run(const std::string& config, double load, const std::string& json_file) {
  const TrackingSettings settings = read_tracking(Section::load(config));
  const std::pair<const char*, Variant> variants[] = {{"ours", Variant::ours},
                                                      {"measured_anchor", Variant::measured_anchor},
                                                      {"half_rotation", Variant::half_rotation}};
  std::printf(
      "Lissajous 0.20 x 0.20 x 0.10 m with 0.8 rad of yaw and 0.2 rad of tilt either way, %.0f s,\n"
      "commands at 10 Hz, chunks of %d of which %d are executed; steady: %.0f s after the end.\n"
      "delayed: against the path 2 / omega = %.0f ms earlier, the reference's own lag.\n\n",
      kPathSeconds, kHorizon, kExecute, kHoldSeconds, 2e3 / settings.reference.omega);
  std::printf("%-16s %6s  %32s  %32s\n", "", "", "position, mm", "rotation, mrad");
  std::printf("%-16s %6s", "variant", "load N");
  for (int i = 0; i < 2; ++i) std::printf("  %7s %7s %7s %8s", "rms", "max", "steady", "delayed");
  std::printf("\n");

  nlohmann::json rows = nlohmann::json::array();
  for (const double force : {0.0, load}) {
    for (const auto& [name, variant] : variants) {
      const Tracking t = follow_path(variant, settings, force, "models");
      std::printf("%-16s %6.1f  %7.2f %7.2f %7.2f %8.2f  %7.2f %7.2f %7.2f %8.2f\n", name, force,
                  1e3 * t.position_rms, 1e3 * t.position_max, 1e3 * t.position_steady,
                  1e3 * t.delayed_position_rms, 1e3 * t.rotation_rms, 1e3 * t.rotation_max,
                  1e3 * t.rotation_steady, 1e3 * t.delayed_rotation_rms);
      nlohmann::json row = to_json(t);
      row["variant"] = name;
      row["load_N"] = force;
      rows.push_back(row);
    }
  }
  if (!json_file.empty()) {
    std::ofstream out(json_file);
    out << nlohmann::json{{"rows", rows}}.dump(2) << "\n";
    if (!out) throw std::runtime_error(json_file + " can't be written.");
  }
  return 0;
}

}  // namespace
}  // namespace tandem::bench

int main(int argc, char** argv) {
  CLI::App app("Tracking error on a test path in free space, beside two other designs.");
  std::string config = "config/controller.yaml", json_file;
  double load = 2.0;
  app.add_option("--controller", config, "Settings of the controller.")->capture_default_str();
  app.add_option("--load", load, "N, weight of the load that the robot does not know.")
      ->check(CLI::Range(0.1, 10.0))
      ->capture_default_str();
  app.add_option("--json", json_file, "File for the figures.");
  CLI11_PARSE(app, argc, argv);
  try {
    return tandem::bench::run(config, load, json_file);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
