#pragma once

#include <array>
#include <variant>

#include "controller/chunk/chunk.h"
#include "controller/law/cartesian_impedance.h"
#include "controller/robot/robot.h"
#include "controller/task/observation.h"
#include "controller/task/scene.h"
#include "intervention/command_check.h"

/// What the control thread tells the recorder: one ring of fixed-size records, in the order in
/// which things took effect.
namespace tandem {

struct EpisodeBegin {
  int64_t episode = 0;
  uint64_t episode_seed = 0;
  Phase phase = Phase::training;
  int32_t policy_version = 0;
  bool has_policy = true;  ///< somebody will say what to do when the human does not
};

/// What a tick is told beside the robot's state: the time, and how its partners are.
struct TickInput {
  int64_t utime = 0;          ///< us, monotonic; in lockstep simulated
  int32_t missed_cycles = 0;  ///< control cycles that passed without a command just before
  double link_age_ms = 0.0;   ///< since the link thread was last alive; 0 in lockstep
};

/// One control tick.
struct TickRecord {
  TickInput input;
  int64_t tick = 0;
  RobotState robot;
  Pose X_WE;            ///< measured
  Pose X_WE_reference;  ///< what the law tracked
  Twist V_WE = Twist::Zero();
  Wrench F_ext_W = Wrench::Zero();  ///< filtered
  Wrench force_bound = Wrench::Zero();
  JointVector tau_commanded = JointVector::Zero();  ///< after every limit
  double alpha = 0.0;
  uint32_t limits_acted = 0;  ///< bits of SafetyFilter::Limit
};

/// The observation of a step, once the policy thread has built it; step max + 1 closes the last
/// one.
struct ObservationRecord {
  int32_t step = 0;
  int32_t image_step = -1;  ///< step whose camera frame the policy saw; -1 = none
  std::array<float, kMaxObservation> values{};
};

struct ChunkRecord {
  int64_t start_tick = 0, taken_tick = 0;
  Chunk chunk;
};

/// New gains began to ramp in.
struct GainsRecord {
  int64_t utime = 0;
  ImpedanceGains gains;
};

/// What happened during one policy step.
struct StepRecord {
  int64_t utime = 0;  ///< us, when the step began
  int32_t step = 0;
  Action policy = Action::Zero(), human = Action::Zero(), executed = Action::Zero();
  double alpha_mean = 0.0;
  bool intervention = false, took_over = false;
  int32_t policy_version = 0, chunk_id = -1, chunk_index = -1;
  double force_peak = 0.0;           ///< N, unfiltered
  double force_filtered_peak = 0.0;  ///< N
  uint64_t torque_digest = 0;        ///< over the bits of every commanded torque
};

/// A fault was latched.
struct FaultRecord {
  int64_t utime = 0;
  int64_t episode = -1, tick = 0;  ///< that it ended; -1: none was running
  Fault fault = Fault::none;
  int32_t faults_in_a_row = 0, faults_allowed = 0;
};

struct EpisodeFinish {
  int64_t utime = 0;
  Outcome outcome = Outcome::timeout;
  Fault fault = Fault::none;
};

/// A policy was put in force between two episodes (lockstep) or between two chunks (real time).
struct PolicyInForce {
  int64_t utime = 0;
  int32_t version = 0;
};

using Record =
    std::variant<EpisodeBegin, TickRecord, ObservationRecord, StepSnapshot, ChunkRecord,
                 HumanCommand, GainsRecord, StepRecord, FaultRecord, EpisodeFinish, PolicyInForce>;

}  // namespace tandem
