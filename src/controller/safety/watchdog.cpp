#include "controller/safety/watchdog.h"

#include <sstream>

namespace tandem {
namespace {

constexpr double kLongest = 600000.0;  // ms

[[noreturn]] void out_of_order(const Section& section, const char* later, double late,
                               const char* earlier, double early) {
  std::ostringstream out;
  out << section.place(later) << " is " << late << " ms; it must not be less than " << earlier
      << ", which is " << early << " ms.";
  throw ScenarioError(out.str());
}

WatchdogLimits read_limits(Section& section) {
  WatchdogLimits limits;
  limits.hold_after_ms = section.number("hold_after_ms", 0.0, kLongest);
  limits.damp_after_ms = section.number("damp_after_ms", 0.0, kLongest);
  limits.stop_after_ms = section.number("stop_after_ms", 0.0, kLongest);
  if (limits.damp_after_ms < limits.hold_after_ms)
    out_of_order(section, "damp_after_ms", limits.damp_after_ms, "hold_after_ms",
                 limits.hold_after_ms);
  if (limits.stop_after_ms < limits.damp_after_ms)
    out_of_order(section, "stop_after_ms", limits.stop_after_ms, "damp_after_ms",
                 limits.damp_after_ms);
  return limits;
}

}  // namespace

WatchdogSettings read_watchdog(Section section) {
  WatchdogSettings settings;
  Section policy = section.section("policy");
  settings.policy = read_limits(policy);
  policy.finish();

  Section human = section.section("operator");
  settings.operator_ = read_limits(human);
  settings.operator_release_after_ms = human.number("release_after_ms", 0.0, kLongest);
  if (settings.operator_release_after_ms < settings.operator_.hold_after_ms)
    out_of_order(human, "release_after_ms", settings.operator_release_after_ms, "hold_after_ms",
                 settings.operator_.hold_after_ms);
  human.finish();

  Section link = section.section("link");
  settings.link = read_limits(link);
  link.finish();
  section.finish();
  return settings;
}

}  // namespace tandem
