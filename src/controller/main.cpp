// tandem_controller: the arm's side of Tandem. See --help, and docs/ARCHITECTURE.md for the way of
// the data.

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <tandem/scenario_t.hpp>

#include "controller/camera/camera_worker.h"
#include "controller/episode/provenance.h"
#include "controller/loop/run.h"
#include "controller/loop/scenario.h"
#include "policy_runtime/kernels/kernels.h"

namespace tandem {
namespace {

constexpr size_t kRecordRing = 2048;

std::atomic<bool>* stop_flag = nullptr;

void on_signal(int) {
  if (stop_flag) stop_flag->store(true);
}

std::string whole_file(const std::string& path) {
  std::ostringstream text;
  text << std::ifstream(path).rdbuf();
  return text.str();
}

void write_scenario(EventLog& log, const std::string& path, const Task& task,
                    int64_t first_episode) {
  scenario_t m;
  m.utime = 0;
  m.scenario_yaml = whole_file(path);
  m.git_revision = TANDEM_GIT_REVISION;
  for (const std::string& name : task.observation().names()) {
    m.observation_names += (m.observation_names.empty() ? "" : ",") + name;
  }
  m.first_episode = first_episode;
  log.write("SCENARIO", 0, m);
}

nlohmann::json summary(const Histogram& histogram) {
  const Histogram::Summary s = histogram.summary();
  return {{"p50", s[0]}, {"p99", s[1]}, {"p999", s[2]}, {"max", s[3]}};
}

nlohmann::json counts(const Histogram& histogram) {
  return {{"bucket_us", 1e-3 * Histogram::kBucketNs},
          {"counts", histogram.counts()},
          {"max_us", histogram.summary()[3]}};
}

void write_results(const std::string& path, const std::vector<episode_end_t>& episodes,
                   const StatusBoard& board, double wall_s, int64_t env_steps) {
  const char* outcomes[] = {"success", "timeout", "fault", "discard", "failure"};
  const char* phases[] = {"demonstration", "training", "evaluation"};
  nlohmann::json rows = nlohmann::json::array();
  for (const episode_end_t& end : episodes) {
    rows.push_back({{"episode", end.episode},
                    {"seed", end.episode_seed},
                    {"phase", phases[end.phase]},
                    {"outcome", outcomes[end.outcome]},
                    {"fault", end.fault},
                    {"n_steps", end.n_steps},
                    {"n_intervention_steps", end.n_intervention_steps},
                    {"n_takeovers", end.n_takeovers},
                    {"force_peak", end.force_peak},
                    {"force_filtered_peak", end.force_filtered_peak}});
  }
  nlohmann::json results = {{"episodes", rows},
                            {"env_steps", env_steps},
                            {"wall_s", wall_s},
                            {"env_steps_per_s", static_cast<double>(env_steps) / wall_s},
                            {"ticks", board.ticks.load()},
                            {"overruns", board.overruns.load()},
                            {"records_dropped", board.records_dropped.load()},
                            {"tick_compute_us", summary(board.tick_time)},
                            {"robot_us", summary(board.robot_time)},
                            {"kernel", policy::kernel_name()},
                            {"wakeup_us", summary(board.wakeup)},
                            {"tick_compute_histogram_us", counts(board.tick_time)},
                            {"wakeup_histogram_us", counts(board.wakeup)},
                            {"policy_latency_ticks_max", board.policy_latency_ticks[1].load()}};
  if (board.camera_frames > 0) {
    results["camera"] = {{"frames", board.camera_frames.load()},
                         {"late", board.camera_late.load()},
                         {"frame_us", summary(board.camera_time)}};
  }
  if (counts_allocations()) results["allocations"] = board.allocations.load();
  std::ofstream file(path);
  file << results.dump(1) << "\n";
  if (!file.good())
    throw std::runtime_error(path + ": the results can't be written; check folder and disk space.");
}

int run(const std::string& scenario_path, const std::string& run_folder, const std::string& lcm_url,
        const std::string& root, const std::string& results_path) {
  Scenario scenario = read_scenario(Section::load(scenario_path));
  Task& task = *scenario.task;
  const bool trains = scenario.run.mode == RunMode::train;
  const bool has_partners = trains || scenario.run.mode == RunMode::demonstrate;

  Arm arm(task, root);
  MujocoRobot robot(arm.simulation, scenario.control.robot);

  // The log says where an earlier run stopped.
  std::optional<EventLog> log;
  RunPosition position;
  if (!run_folder.empty()) {
    std::filesystem::create_directories(run_folder);
    log.emplace((std::filesystem::path(run_folder) / "log.lcm").string(), scenario.run.log);
    for (const episode_end_t& end : log->past().episodes) position.add(end);
    if (log->past().gains) {
      gains_from(*log->past().gains, scenario.control.gains, scenario.control.gains);
    }
    if (!log->past().has_scenario) write_scenario(*log, scenario_path, task, position.next_episode);
    log->write("PROVENANCE", 0,
               provenance(TANDEM_GIT_REVISION, whole_file(scenario_path),
                          static_cast<int64_t>(scenario.run.seed), position.next_episode));
  }

  StatusBoard board;
  stop_flag = &board.stop;
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  std::signal(SIGPIPE, SIG_IGN);

  std::vector<policy::Camera> cameras;
  if (scenario.run.sees) {
    const CameraSettings& c = scenario.control.camera;
    cameras.push_back({c.name, c.height, c.image_width()});
  }
  policy::PolicySlot slot;
  SpscRing<Record> records(kRecordRing);
  std::unique_ptr<Link> link;
  std::unique_ptr<PolicyLoader> loader;
  if (has_partners) {
    link = std::make_unique<Link>(
        Link::Settings{.url = lcm_url,
                       .lockstep = scenario.run.lockstep,
                       .learner = trains,
                       .env_steps_budget = trains ? scenario.run.env_steps : 0,
                       .gains = scenario.control.gains},
        task.spec(), board);
    loader = std::make_unique<PolicyLoader>(
        slot, task,
        PolicyLoader::Settings{run_folder, scenario.horizon, scenario.run.lockstep, cameras},
        [&](const policy_ack_t& ack) {
          link->send(ack);
          board.policies_rejected = loader ? loader->refused_count() : 0;
        });
    link->on_announcement([&](const policy_announce_t& m) { loader->announce(m); });
    link->start();
  }
  if (scenario.run.mode == RunMode::evaluate) {
    slot.publish(load_policy(scenario.run.policy, "", task, scenario.horizon, cameras));
  }

  RecorderSinks sinks;
  if (link) {
    sinks.episode = [&](std::shared_ptr<const FinishedEpisode> episode) {
      link->send(std::move(episode));
    };
    sinks.robot_state = [&](const robot_state_t& state) { link->send(state); };
    sinks.chunk = [&](const action_chunk_t& chunk) { link->send(chunk); };
    sinks.fault = [&](const controller_fault_t& fault) { link->send(fault); };
    sinks.status = [&] { return link->status(); };
    sinks.announcement = [&](int32_t version) { return loader->announcement(version); };
  }
  const int hz = scenario.run.robot_state_hz;
  Recorder recorder(records, log ? &*log : nullptr, task.spec(), task.observation().size(),
                    {.discount = scenario.discount,
                     .robot_state_every = hz > 0 ? std::max(1, 1000 / hz) : 0,
                     .every_tick = !scenario.run.lockstep,
                     .env_steps = position.env_steps},
                    sinks, board);

  const int64_t steps_before = position.env_steps;
  ControlLoop loop(robot, arm.model, task.spec(), scenario.control, scenario.execution, records);
  const int policy_priority = scenario.run.lockstep ? 0 : scenario.control.realtime.priority / 2;
  std::unique_ptr<CameraWorker> camera;
  if (scenario.run.sees) {
    const std::string channel = scenario.control.camera.channel();
    camera = std::make_unique<CameraWorker>(
        arm.simulation, scenario.control.camera, scenario.run.lockstep,
        [&, channel](std::shared_ptr<const CameraFrame> frame) {
          recorder.keep(frame);
          if (link) link->send(std::move(frame), channel);
        },
        board);
  }
  PolicyWorker worker(task, slot, policy_priority, camera.get());
  Run programme(scenario.run, scenario.control, task, robot, arm.model, loop, worker, link.get(),
                loader.get(), records, board, std::move(position));
  const int64_t start_us = monotonic_us();
  int code = programme.execute();
  const double wall_s = 1e-6 * static_cast<double>(monotonic_us() - start_us);

  recorder.stop();
  if (log && !log->failure().empty()) {
    std::fprintf(stderr, "%s\n", log->failure().c_str());
    code = 3;
  }
  if (link) {
    // A learner that still works gets what it has not confirmed; what it misses, it finds in the
    // log.
    for (int i = 0; code == 0 && i < 100 && board.episodes_unacknowledged > 0; ++i) usleep(100'000);
    link->stop();
  }
  if (!results_path.empty()) {
    int64_t env_steps = 0;
    for (const episode_end_t& end : recorder.episodes()) env_steps += end.n_steps;
    if (trains) env_steps = board.env_steps - steps_before;
    write_results(results_path, recorder.episodes(), board, wall_s, env_steps);
  }
  stop_flag = nullptr;
  return code;
}

}  // namespace
}  // namespace tandem

int main(int argc, char** argv) {
  CLI::App app{
      "The arm's side of Tandem: 1 kHz control loop, policy, recorder. './tandem train' starts and "
      "supervises it."};
  std::string scenario, run_folder, results, kernel, root = ".";
  const char* environment_url = std::getenv("LCM_DEFAULT_URL");
  std::string lcm_url = environment_url ? environment_url : "";
  bool check = false;
  app.add_option("--scenario", scenario, "resolved scenario (YAML); its comments name every unit")
      ->required();
  app.add_option("--run", run_folder, "folder for log.lcm; a log that is there is continued");
  app.add_option("--lcm-url", lcm_url,
                 "LCM network, e.g. udpm://239.255.76.67:7667?ttl=0 [LCM_DEFAULT_URL]");
  app.add_option("--root", root, "root of the checkout, where models/ lies [.]");
  app.add_option("--results", results, "file for a JSON summary of all episodes");
  app.add_option("--kernel", kernel,
                 "instruction set of the policy: scalar, AVX2, ... [TANDEM_KERNEL, else the best]");
  app.add_flag("--check", check, "only check the scenario: exit 0, or 2 with a sentence");
  CLI11_PARSE(app, argc, argv);
  try {
    if (check) {
      tandem::read_scenario(tandem::Section::load(scenario));
      return 0;
    }
    if (!kernel.empty()) tandem::policy::force_kernel(kernel);
    return tandem::run(scenario, run_folder, lcm_url, root, results);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 2;
  }
}
