// tandem_replay: computes a logged run again and compares every torque. See replay.h.

#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>

#include "controller/replay/replay.h"

namespace tandem {
namespace {

int run(const std::string& log, const std::string& root, int64_t episodes,
        const std::string& json) {
  Replay replay(log, root);
  const ReplayResult result = replay.run(episodes, [](const ReplayResult& so_far) {
    if (so_far.episodes % 20 == 0) {
      std::printf("%lld episodes, %lld ticks, %lld differences\n",
                  static_cast<long long>(so_far.episodes), static_cast<long long>(so_far.ticks),
                  static_cast<long long>(so_far.differences));
      std::fflush(stdout);
    }
  });
  nlohmann::json report = {{"clock", replay.lockstep() ? "lockstep" : "realtime"},
                           {"episodes", result.episodes},
                           {"episodes_without_motion", result.without_motion},
                           {"steps", result.steps},
                           {"ticks", result.ticks},
                           {"torques_one_by_one", result.torques},
                           {"differences", result.differences},
                           {"logged_by", replay.git_revision()}};
  if (result.first) {
    report["first_difference"] = {{"episode", result.first->episode},
                                  {"tick", result.first->tick},
                                  {"what", result.first->what}};
  }
  if (!json.empty()) std::ofstream(json) << report.dump(1) << "\n";

  std::printf(
      "%s: %lld episodes, %lld steps, %lld ticks computed again; %lld torques compared one "
      "by one, %s; %lld differences.\n",
      replay.lockstep() ? "lockstep" : "realtime", static_cast<long long>(result.episodes),
      static_cast<long long>(result.steps), static_cast<long long>(result.ticks),
      static_cast<long long>(result.torques), "all of them by the digests of the steps",
      static_cast<long long>(result.differences));
  if (result.episodes == 0) {
    std::fprintf(stderr, "%s holds no complete episode.\n", log.c_str());
    return 2;
  }
  if (result.without_motion > 0) {
    std::fprintf(stderr,
                 "%lld of the episodes were recorded without motion (brought in from elsewhere, or "
                 "beyond run.log_quota_mb), and are not computed again.\n",
                 static_cast<long long>(result.without_motion));
  }
  if (result.without_motion == result.episodes) return 2;
  if (!result.first) return 0;
  std::fprintf(stderr,
               "First difference: episode %lld, tick %lld: %s. Logged by revision %s; another "
               "program, scenario file or model explains it, the same ones would be a bug.\n",
               static_cast<long long>(result.first->episode),
               static_cast<long long>(result.first->tick), result.first->what.c_str(),
               replay.git_revision().c_str());
  return 1;
}

}  // namespace
}  // namespace tandem

int main(int argc, char** argv) {
  CLI::App app{"Computes a logged run again, and compares every torque bit for bit."};
  std::string log, root = ".", json;
  int64_t episodes = 0;
  app.add_option("log", log, "log.lcm of a run")->required();
  app.add_option("--root", root, "root of the checkout, where models/ lies [.]");
  app.add_option("--episodes", episodes, "at most so many; 0 = all [0]");
  app.add_option("--json", json, "file for the result");
  CLI11_PARSE(app, argc, argv);
  try {
    return tandem::run(log, root, episodes, json);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 2;
  }
}
