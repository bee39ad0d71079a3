#include "controller/robot/hole.h"

#include <cmath>
#include <stdexcept>
#include <string>

namespace tandem {
namespace {

constexpr double kChamfer = 0.001;      // m, at 45 degrees
constexpr double kChamferBody = 0.002;  // m, half thickness of the turned box behind the slope

double peg_half_width(const Simulation& simulation) {
  return simulation.model()->geom_size[3 * simulation.geom("peg")];
}

// Position and half size of a box, and the radius by which MuJoCo's broad phase knows it.
void set_box(mjModel* model, int geom, const Eigen::Vector3d& position,
             const Eigen::Vector3d& half_size) {
  Eigen::Vector3d::Map(model->geom_pos + 3 * geom) = position;
  Eigen::Vector3d::Map(model->geom_size + 3 * geom) = half_size;
  model->geom_rbound[geom] = half_size.norm();
  model->geom_sameframe[geom] =
      0;  // the compiler may have found that the old position is the body's; compute the pose again
}

}  // namespace

void set_hole_clearance(Simulation& simulation, double clearance) {
  if (!(clearance >= 5e-5 && clearance <= 2e-3)) {
    throw std::invalid_argument(
        "The hole's clearance is " + std::to_string(1e3 * clearance) +
        " mm a side; it must be in [0.05, 2] mm. The default is 0.5, the hard task 0.2.");
  }
  mjModel* model = simulation.model();
  const double inner = peg_half_width(simulation) + clearance;
  const double outer = inner + kChamfer;
  const double block = model->geom_size[3 * simulation.geom("hole_floor")];  // half width
  for (const char axis : {'x', 'y'}) {
    for (const char side : {'p', 'm'}) {
      const double sign = side == 'p' ? 1.0 : -1.0;
      // `across` is the distance from the hole's axis, `along` the half length of the side, `up`
      // the height.
      const auto place = [&](const char* part, double across, double half_across,
                             double half_along) {
        const int geom = simulation.geom(std::string("hole_") + part + "_" + axis + side);
        const double up = model->geom_pos[3 * geom + 2], half_up = model->geom_size[3 * geom + 2];
        if (axis == 'x') {
          set_box(model, geom, {sign * across, 0, up}, {half_across, half_along, half_up});
        } else {
          set_box(model, geom, {0, sign * across, up}, {half_along, half_across, half_up});
        }
      };
      const bool x =
          axis == 'x';  // the sides at +-x run over the whole block, those at +-y between them
      place("wall", 0.5 * (block + inner), 0.5 * (block - inner), x ? block : inner);
      place("plate", 0.5 * (block + outer), 0.5 * (block - outer), x ? block : outer);
      place("chamfer", inner + 0.5 * kChamfer + kChamferBody / std::sqrt(2.0), kChamferBody, outer);
    }
  }
  simulation.forward();
}

double hole_clearance(const Simulation& simulation) {
  const int wall = simulation.geom("hole_wall_xp");
  const double inner =
      simulation.model()->geom_pos[3 * wall] - simulation.model()->geom_size[3 * wall];
  return inner - peg_half_width(simulation);
}

}  // namespace tandem
