#include "controller/chunk/execution_settings.h"

namespace tandem {

ExecutionSettings read_execution(Section section, int horizon, int ticks_per_step) {
  ExecutionSettings settings;
  const std::string mode = section.choice("mode", {"receding", "open_loop", "temporal_ensembling"});
  settings.mode = mode == "receding"    ? ExecutionMode::receding
                  : mode == "open_loop" ? ExecutionMode::open_loop
                                        : ExecutionMode::temporal_ensembling;
  settings.horizon = horizon;
  settings.execute = static_cast<int>(section.integer("execute", 1, horizon));
  settings.ensemble_decay = section.number("ensemble_decay", -10.0, 10.0);
  settings.latency_ticks =
      static_cast<int>(section.integer("latency_ticks", 0, ticks_per_step - 1));
  settings.noise_chunk = section.number("noise_chunk", 0.0, 1.0);
  settings.noise_step = section.number("noise_step", 0.0, 1.0);
  settings.noise_clip = section.number("noise_clip", 0.0, 2.0);
  settings.noise_speed = section.number("noise_speed", 0.0, 4.0);
  section.finish();
  return settings;
}

}  // namespace tandem
