#include "controller/loop/control_settings.h"

namespace tandem {

ControlSettings read_control(Section section) {
  ControlSettings settings;
  settings.gains = read_gains(section.section("law"));
  settings.reference = read_reference(section.section("reference"));
  Section handover = section.section("handover");
  settings.ramp_in_ticks = static_cast<int>(handover.integer("ramp_in_ms", 1, 50));
  settings.ramp_out_ticks = static_cast<int>(handover.integer("ramp_out_ms", 1, 1000));
  handover.finish();
  settings.watchdog = read_watchdog(section.section("watchdog"));
  settings.safety = read_safety(section.section("safety"));
  settings.robot = read_robot(section.section("robot"));
  settings.faults_in_a_row = static_cast<int>(section.integer("faults_in_a_row", 1, 1000));
  settings.force_filter_hz = section.number("force_filter_hz", 0.5, 400.0);
  settings.camera = read_camera(section.section("camera"));
  Section realtime = section.section("realtime");
  settings.realtime.priority = static_cast<int>(realtime.integer("priority", 1, 98));
  settings.realtime.core = static_cast<int>(realtime.integer("core", -1, 1023));
  realtime.finish();
  section.finish();
  return settings;
}

}  // namespace tandem
