// tandem_operator: the scripted operator as a process of its own; it speaks LCM and nothing else.

#include <CLI/CLI.hpp>
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <lcm/lcm-cpp.hpp>
#include <tandem/controller_command_t.hpp>
#include <tandem/controller_status_t.hpp>

#include "controller/robot/fault.h"
#include "intervention/scripted_operator.h"

namespace tandem {
namespace {

std::atomic<bool> stop{false};

/// Answers every WORLD_STATE until told to end.
class OperatorProcess {
 public:
  OperatorProcess(const std::string& url, const OperatorRules& rules)
      : lcm_(url), operator_(rules) {
    if (!lcm_.good()) {
      throw std::runtime_error("LCM can't be started on '" + url +
                               "'; './tandem doctor' checks the network.");
    }
    lcm_.subscribe<world_state_t>("WORLD_STATE",
                                  [this](const lcm::ReceiveBuffer*, const std::string&,
                                         const world_state_t* world) { answer(*world); });
    lcm_.subscribe<controller_status_t>(
        "CONTROLLER_STATUS", [this](const lcm::ReceiveBuffer*, const std::string&,
                                    const controller_status_t* status) { obey(*status); });
  }

  void run() {
    while (!stop) lcm_.handleTimeout(200);
    std::printf("%lld WORLD_STATEs answered\n", static_cast<long long>(answered_));
  }

 private:
  void answer(const world_state_t& world) {
    const teleop_command_t command = operator_.answer(world);
    lcm_.publish("TELEOP_COMMAND", &command);
    ++answered_;
  }

  void obey(const controller_status_t& status) {
    if (status.state == controller_status_t::FINISHED ||
        status.state == controller_status_t::FAULTED)
      stop = true;
    if (status.state == controller_status_t::HALTED) recover(status);
  }

  /// He presses the button that a person would press after a fault. A stop that someone asked for
  /// is not his to undo.
  void recover(const controller_status_t& status) {
    const auto now = std::chrono::steady_clock::now();
    const auto fault = static_cast<Fault>(status.fault);
    if (fault == Fault::estop || fault == Fault::user_stop || now - recovered_ < kPressAgain)
      return;
    recovered_ = now;
    controller_command_t command;
    command.utime =
        std::chrono::duration_cast<std::chrono::microseconds>(now.time_since_epoch()).count();
    command.order = controller_command_t::RECOVER;
    command.reason = "the scripted operator goes on";
    lcm_.publish("CONTROLLER_COMMAND", &command);
  }

  /// Several status periods: he waits for what his last press did.
  static constexpr std::chrono::milliseconds kPressAgain{700};

  lcm::LCM lcm_;
  ScriptedOperator operator_;
  int64_t answered_ = 0;
  std::chrono::steady_clock::time_point recovered_{};
};

OperatorRules rules_of_scenario(const std::string& path) {
  Section root = Section::load(path);
  return read_rules(root.section("operator"));
}

}  // namespace
}  // namespace tandem

int main(int argc, char** argv) {
  CLI::App app{
      "A person's stand-in: demonstrates, watches, takes over and lets go by the rules of "
      "config/operator.yaml."};
  std::string scenario;
  const char* environment_url = std::getenv("LCM_DEFAULT_URL");
  std::string lcm_url = environment_url ? environment_url : "";
  bool check = false;
  app.add_option("--scenario", scenario, "resolved scenario (YAML)")->required();
  app.add_option("--lcm-url", lcm_url,
                 "LCM network, e.g. udpm://239.255.76.67:7667?ttl=0 [LCM_DEFAULT_URL]");
  app.add_flag("--check", check, "only check the scenario: exit 0, or 2 with a sentence");
  CLI11_PARSE(app, argc, argv);
  std::signal(SIGINT, [](int) { tandem::stop = true; });
  std::signal(SIGTERM, [](int) { tandem::stop = true; });
  try {
    const tandem::OperatorRules rules = tandem::rules_of_scenario(scenario);
    if (!check) tandem::OperatorProcess(lcm_url, rules).run();
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 2;
  }
}
