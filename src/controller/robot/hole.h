#pragma once

#include "controller/robot/simulation.h"

namespace tandem {

/// Gives the square hole of models/peg/scene.xml another clearance: its opening becomes peg width +
/// 2 clearance (m, a side) by moving walls, plates and chamfers; outer size, depth and the 1 mm
/// chamfer stay. Not real-time. Ends with Simulation::forward().
/// @throws std::invalid_argument if the clearance is out of [0.05, 2] mm; std::runtime_error if the
/// scene has no such hole.
void set_hole_clearance(Simulation& simulation, double clearance);

/// m, the present clearance between peg and wall on each side when the peg is centred.
double hole_clearance(const Simulation& simulation);

}  // namespace tandem
