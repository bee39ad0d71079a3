#include "tracking_path.h"

#include <algorithm>
#include <cmath>

namespace tandem::bench {
namespace {

constexpr double kPi = 3.141592653589793;
constexpr double kPeriod = 16.0;  // s

/// s at `seconds`: rises with (1 - cos) / 2 in the first second, falls so in the last.
double progress(double seconds) {
  const double t = std::clamp(seconds, 0.0, kPathSeconds);
  const auto run_up = [](double u) { return 0.5 * u - std::sin(kPi * u) / (2.0 * kPi); };
  if (t < 1.0) return run_up(t);
  if (t > kPathSeconds - 1.0) return kPeriod - run_up(kPathSeconds - t);
  return t - 0.5;
}

}  // namespace

Pose path_start() { return {{0.5, 0.0, 0.3}, Eigen::Quaterniond(0, 1, 0, 0)}; }

Pose path(double seconds) {
  const double turn = 2.0 * kPi * progress(seconds) / kPeriod;
  Twist d;
  d << 0.10 * std::sin(2.0 * turn), 0.10 * std::sin(3.0 * turn), 0.05 * std::sin(4.0 * turn),
      0.2 * std::sin(3.0 * turn), 0.0, 0.8 * std::sin(2.0 * turn);
  return add(path_start(), d);
}

Twist action_limit() {
  Twist limit;
  limit << 0.012, 0.012, 0.012, 0.10, 0.10, 0.10;
  return limit;
}

std::vector<Action> path_actions() {
  constexpr double kStep = kTicksPerStep * 0.001;  // s
  std::vector<Action> actions(kSteps, Action::Zero());
  for (int i = 0; i < kSteps; ++i) {
    actions[i].head<6>() =
        minus(path((i + 1) * kStep), path(i * kStep)).cwiseQuotient(action_limit());
  }
  return actions;
}

}  // namespace tandem::bench
