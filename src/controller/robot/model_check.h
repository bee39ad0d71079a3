#pragma once

#include <cstdint>

#include "controller/law/arm_model.h"
#include "controller/robot/simulation.h"

namespace tandem {

/// Largest differences between the law's model and the robot's, each relative to max(1, largest
/// entry), SI units.
struct ModelErrors {
  double pose = 0.0, jacobian = 0.0, mass = 0.0, gravity = 0.0, coriolis = 0.0;
};

/// Start-up check: pose, Jacobian, mass matrix, gravity and Coriolis of ArmModel (URDF, KDL)
/// against the simulated robot (MJCF, MuJoCo) at `states` random states within the joint limits,
/// the same ones for the same seed. The simulation is not touched. An object in hand must have been
/// given to the model: arm.set_load(simulation.held_load()).
/// @returns the errors, all at most `bound`. @throws std::runtime_error: which entry, both values,
/// and what to mend.
ModelErrors check_model(const Simulation& simulation, ArmModel& arm, double bound = 1e-9,
                        int states = 100, uint64_t seed = 1);

}  // namespace tandem
