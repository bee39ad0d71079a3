#include "intervention/scripted_operator.h"

#include <algorithm>
#include <cmath>

#include "base/random.h"

namespace tandem {
namespace {

// How he tells by eye: fingers this near to the width of what they hold hold it, when the hand is
// this near to it; an object this near to its end is placed; fingers this much wider are off it.
constexpr double kHeldWidth = 0.003, kHeldReach = 0.02, kPlaced = 0.003, kFreeWidth = 0.008;  // m
constexpr double kToppled = 0.8;     // rad, what lies like this without being held stays so
constexpr double kInside = 0.005;    // m off the axis: what is below the goal's rim is inside of it
constexpr double kOverGoal = 0.01;   // m off the axis: nearer, he is over the goal
constexpr double kCalmAhead = 0.03;  // m before the end of a leg that his hand begins to calm down
constexpr double kGraspAhead = 0.1;  // m of way that taking hold counts for

Pose pose(const double* p, const double* q) {
  return {{p[0], p[1], p[2]}, Eigen::Quaterniond(q[0], q[1], q[2], q[3])};
}

}  // namespace

OperatorRules read_rules(Section section) {
  OperatorRules r;
  r.name = section.text("name");
  if (r.name.size() > 31)
    throw ScenarioError(section.place("name") + " is longer than 31 characters.");
  Section hand = section.section("hand");
  r.speed_low = hand.number("speed_low", 0.05, 1.0);
  r.speed_high = hand.number("speed_high", r.speed_low, 1.0);
  r.gain = hand.number("gain", 0.05, 1.0);
  r.see_bias_m = hand.number("see_bias_m", 0.0, 0.02);
  r.see_bias_rad = hand.number("see_bias_rad", 0.0, 0.3);
  r.see_delay_steps = static_cast<int>(hand.integer("see_delay_steps", 0, 20));
  r.tremor = hand.number("tremor", 0.0, 1.0);
  r.tremor_memory = hand.number("tremor_memory", 0.0, 0.99);
  r.pause_probability = hand.number("pause_probability", 0.0, 0.5);
  r.pause_steps = static_cast<int>(hand.integer("pause_steps", 1, 50));
  r.hover_m = hand.number("hover_m", 0.002, 0.1);
  r.clear_low_m = hand.number("clear_low_m", r.hover_m, 0.2);
  r.clear_high_m = hand.number("clear_high_m", r.clear_low_m, 0.2);
  r.align_m = hand.number("align_m", 0.0001, 0.01);
  r.align_rad = hand.number("align_rad", 0.001, 0.3);
  r.touch_m = hand.number("touch_m", 0.0, 0.05);
  r.touch_force = hand.number("touch_force_N", 0.0, 100.0);
  r.push_force = hand.number("push_force_N", 0.5, 100.0);
  r.wiggle_after_steps = static_cast<int>(hand.integer("wiggle_after_steps", 1, 100));
  r.wiggle_m = hand.number("wiggle_m", 0.0, 0.01);
  Section reach = hand.section("reach");
  r.reach_hover_m = reach.number("hover_m", 0.005, 0.2);
  r.reach_align_m = reach.number("align_m", 0.0001, 0.02);
  r.reach_align_rad = reach.number("align_rad", 0.001, 0.5);
  r.reach_down_m = reach.number("down_m", 0.001, 0.1);
  r.grip_m = reach.number("grip_m", 0.0005, 0.02);
  r.slip_m = reach.number("slip_m", r.grip_m, 0.1);
  r.slip_rad = reach.number("slip_rad", 0.01, 3.2);
  reach.finish();
  hand.finish();
  Section help = section.section("help");
  r.reaction_steps_low = static_cast<int>(help.integer("reaction_steps_low", 0, 50));
  r.reaction_steps_high =
      static_cast<int>(help.integer("reaction_steps_high", r.reaction_steps_low, 50));
  r.no_progress_steps = static_cast<int>(help.integer("no_progress_steps", 2, 10000));
  r.patience_gain = help.number("patience_gain", 0.0, 100.0);
  r.progress_m = help.number("progress_m", 0.0, 0.1);
  r.away_m = help.number("away_m", 0.001, 1.0);
  r.low_m = help.number("low_m", 0.0, 0.1);
  r.askew_rad = help.number("askew_rad", 0.01, 3.2);
  r.beside_m = help.number("beside_m", 0.0, 1.0);
  r.force = help.number("force_N", 1.0, 1000.0);
  r.held_force = help.number("held_force_N", 1.0, 1000.0);
  r.force_steps = static_cast<int>(help.integer("force_steps", 1, 1000));
  r.hurry_steps = static_cast<int>(help.integer("hurry_steps", 0, 10000));
  r.give_up_steps = static_cast<int>(help.integer("give_up_steps", 1, 10000));
  help.finish();
  Section letgo = section.section("letgo");
  r.hold_steps = static_cast<int>(letgo.integer("hold_steps", 1, 1000));
  r.recovered_share = letgo.number("recovered_share", 0.0, 1.0);
  r.seated_m = letgo.number("seated_m", 0.0, 0.1);
  r.near_m = letgo.number("near_m", 0.0, 1.0);
  letgo.finish();
  section.finish();
  return r;
}

teleop_command_t ScriptedOperator::answer(const world_state_t& world) {
  if (world.episode == episode_ && world.tick == last_.tick_answered) return last_;
  if (world.episode != episode_ || world.step == 0) begin_episode(world);

  const View now = look(world);
  views_.push_back(now);
  while (static_cast<int>(views_.size()) > rules_.see_delay_steps + 1) views_.pop_front();
  const bool engaged = wants_authority(world, now);
  putting_back_ = engaged && now.leg == Leg::put_back;

  last_ = teleop_command_t{};
  last_.utime = world.utime;
  last_.episode_answered = world.episode;
  last_.tick_answered = world.tick;
  last_.engaged = engaged ? 1 : 0;
  last_.label =
      engaged && gives_up(now) ? teleop_command_t::LABEL_FAIL : teleop_command_t::LABEL_NONE;
  last_.operator_id = rules_.name;
  const View seen = expect(world, views_.front());
  last_.device_gripper = grip(world, seen);
  const Twist twist = engaged ? move(world, seen) : Twist(Twist::Zero());
  for (int i = 0; i < 6; ++i) last_.device_twist[i] = twist[i];
  return last_;
}

void ScriptedOperator::begin_episode(const world_state_t& world) {
  episode_ = world.episode;
  Random random = random_for(static_cast<uint64_t>(world.episode_seed), Purpose::operator_episode);
  speed_ = random.uniform(rules_.speed_low, rules_.speed_high);
  for (int i = 0; i < 3; ++i) see_bias_[i] = random.normal(rules_.see_bias_m);
  see_bias_yaw_ = random.normal(rules_.see_bias_rad);
  reaction_steps_ = static_cast<int>(std::lround(
      random.uniform(rules_.reaction_steps_low - 0.49, rules_.reaction_steps_high + 0.49)));
  clear_ = random.uniform(rules_.clear_low_m, rules_.clear_high_m);
  X_WH_start_ = pose(world.p_WH, world.q_WH);
  views_.clear();
  tremor_.setZero();
  pause_left_ = stuck_steps_ = 0;
  aligned_ = closing_ = dropping_ = putting_back_ = engaged_ = false;
  reason_steps_ = held_steps_ = since_best_ = force_steps_ = 0;
  best_distance_ = lowest_ = own_best_distance_ = 1e9;
  since_own_best_ = 0;
}

ScriptedOperator::View ScriptedOperator::look(const world_state_t& world) const {
  // The z of hand and object points into what they should meet: turn it about x before comparing.
  const Eigen::Quaterniond turn(0.0, 1.0, 0.0, 0.0);
  const Pose object = pose(world.p_WO, world.q_WO), goal = pose(world.p_WG, world.q_WG),
             hand = pose(world.p_WE, world.q_WE), grasp = pose(world.p_WH, world.q_WH);
  const Eigen::Vector3d into_goal = -(goal.R * Eigen::Vector3d::UnitZ());
  const double object_tilt =
      std::acos(std::clamp((object.R * Eigen::Vector3d::UnitZ()).dot(into_goal), -1.0, 1.0));
  const auto watch = [&](const Pose& moving, const Pose& target, Leg leg) {
    View view;
    view.leg = leg;
    view.tip = target.R.conjugate() * (moving.p - target.p) + see_bias_;
    view.yaw = log_map(target.R * (moving.R * turn).conjugate()).z() + see_bias_yaw_;
    view.tilt = object_tilt;
    view.X_WE = hand;
    view.R_WT = target.R.toRotationMatrix();
    view.distance = (view.tip + Eigen::Vector3d(0.0, 0.0, world.goal_depth)).norm();
    view.carry = view.distance;
    view.force = Eigen::Vector3d(world.F_ext_W[0], world.F_ext_W[1], world.F_ext_W[2]).norm();
    view.gripper_width = world.gripper_width;
    return view;
  };
  View view = watch(object, goal, Leg::place);
  if (world.grasp_width <= 0.0) return view;

  if (world.release && view.tip.z() < kPlaced - world.goal_depth &&
      view.tip.head<2>().norm() < kInside) {
    view.leg = Leg::leave;
    return view;
  }
  const double reach = (hand.p - grasp.p).norm();
  const bool held =
      reach < kHeldReach && std::abs(world.gripper_width - world.grasp_width) < kHeldWidth;
  const bool half_way_in =
      view.tip.z() < -0.5 * world.goal_depth && view.tip.head<2>().norm() < kInside;
  const bool slipped = putting_back_ || reach > rules_.slip_m || object_tilt > rules_.slip_rad;
  if (held && (half_way_in || !slipped)) return view;
  const double carry = view.distance;
  if (held) {
    view = watch(hand, {X_WH_start_.p, X_WH_start_.R * turn}, Leg::put_back);
    view.carry = (X_WH_start_.p - goal.p).norm() + world.goal_depth;
    view.distance = view.tip.norm() + view.carry + 2.0 * kGraspAhead;
    return view;
  }
  view = watch(hand, {grasp.p, grasp.R * turn}, Leg::reach);
  view.carry = carry;
  view.distance = carry + reach + kGraspAhead;
  return view;
}

bool ScriptedOperator::has_reason(const world_state_t& world, const View& now) {
  if (now.distance < best_distance_ - rules_.progress_m) {
    best_distance_ = now.distance;
    since_best_ = 0;
  } else {
    ++since_best_;
  }
  const double bearable =
      world.grasp_width > 0.0 ? rules_.held_force + world.insertion_force : rules_.force;
  force_steps_ = now.force > bearable ? force_steps_ + 1 : 0;

  const double patience = 1.0 + rules_.patience_gain * world.autonomous_success;
  const bool lost = since_best_ > rules_.no_progress_steps * patience;
  const bool away = now.distance > best_distance_ + rules_.away_m;
  const bool rough = force_steps_ >= rules_.force_steps;
  const bool carries = world.grasp_width > 0.0 && now.leg == Leg::place;
  const double off_axis = now.tip.head<2>().norm();
  const bool strikes =
      carries && now.tip.z() < rules_.low_m && off_axis > kInside && off_axis < rules_.beside_m;
  const bool askew = carries && now.tilt > rules_.askew_rad && now.tip.z() > -rules_.seated_m;
  const bool late =
      world.max_steps - world.step < rules_.hurry_steps && now.tip.z() > -rules_.seated_m;
  return lost || away || rough || strikes || askew || late;
}

bool ScriptedOperator::gives_up(const View& now) {
  const bool nearer = now.distance < own_best_distance_ - rules_.progress_m;
  if (nearer) own_best_distance_ = now.distance;
  since_own_best_ = nearer ? 0 : since_own_best_ + 1;
  const bool toppled = now.leg == Leg::reach && now.tilt > kToppled;
  return since_own_best_ > (toppled ? rules_.reaction_steps_high : rules_.give_up_steps);
}

bool ScriptedOperator::lets_go(const world_state_t& world, const View& now) const {
  if (held_steps_ < rules_.hold_steps) return false;
  const bool near = distance_at_takeover_ < rules_.near_m + world.goal_depth;
  if (near) return -now.tip.z() >= rules_.seated_m;
  return now.distance <= rules_.recovered_share * distance_at_takeover_;
}

bool ScriptedOperator::wants_authority(const world_state_t& world, const View& now) {
  if (world.phase == world_state_t::DEMONSTRATION) return true;
  if (world.phase == world_state_t::EVALUATION) return false;
  if (engaged_) {
    ++held_steps_;
    if (now.leg == Leg::reach || now.leg == Leg::put_back) {
      // What he has taken himself he carries half the way.
      distance_at_takeover_ = now.carry;
    }
    if (lets_go(world, now)) {
      engaged_ = false;
      reason_steps_ = since_best_ = force_steps_ = 0;
      best_distance_ = now.distance;
    }
    return engaged_;
  }
  reason_steps_ = has_reason(world, now) ? reason_steps_ + 1 : 0;
  if (reason_steps_ > reaction_steps_) {
    engaged_ = true;
    held_steps_ = since_own_best_ = 0;
    own_best_distance_ = 1e9;
    distance_at_takeover_ = now.distance;
    aligned_ = closing_ = dropping_ = false;
    stuck_steps_ = 0;
    lowest_ = now.tip.z();
  }
  return engaged_;
}

ScriptedOperator::View ScriptedOperator::expect(const world_state_t& world, View seen) const {
  // In contact he trusts his eyes alone: what he asked for and did not get is pressure, not motion.
  if (seen.force > rules_.touch_force) return seen;
  const Pose commanded = pose(world.p_WE_commanded, world.q_WE_commanded);
  const Twist coming = minus(commanded, seen.X_WE);
  seen.tip += seen.R_WT.transpose() * coming.head<3>();
  seen.yaw -= coming[5];
  return seen;
}

Twist ScriptedOperator::move(const world_state_t& world, const View& seen) {
  Random random = random_for(static_cast<uint64_t>(world.episode_seed), Purpose::operator_step,
                             static_cast<uint64_t>(world.step));
  // Pauses, then tremor: a first-order process that keeps its standard deviation.
  if (pause_left_ == 0 && random.uniform(0.0, 1.0) < rules_.pause_probability) {
    pause_left_ = 1 + static_cast<int>(random.uniform(0.0, rules_.pause_steps));
  }
  const double fresh = std::sqrt(1.0 - rules_.tremor_memory * rules_.tremor_memory);
  for (int i = 0; i < 6; ++i) {
    tremor_[i] = rules_.tremor_memory * tremor_[i] + fresh * random.normal(rules_.tremor);
  }
  if (pause_left_ > 0) {
    --pause_left_;
    return Twist::Zero();
  }

  const Eigen::Vector3d wanted = heading(world, seen);
  double turn = seen.leg == Leg::reach || seen.leg == Leg::place ? seen.yaw : 0.0;
  Eigen::Vector3d wiggle = Eigen::Vector3d::Zero();
  if (stuck_steps_ > rules_.wiggle_after_steps) {
    wiggle.x() = random.uniform(-rules_.wiggle_m, rules_.wiggle_m);
    wiggle.y() = random.uniform(-rules_.wiggle_m, rules_.wiggle_m);
    turn += random.uniform(-0.03, 0.03);
  }

  // As a device twist: a share of the error, at most his speed; he presses no further than his hand
  // likes.
  Eigen::Vector3d step = rules_.gain * (seen.R_WT * (wanted + wiggle));
  const bool to_grasp = seen.leg == Leg::reach || seen.leg == Leg::put_back;
  if (to_grasp) {
    if (seen.tip.z() < rules_.reach_hover_m) step.z() = std::max(step.z(), -rules_.reach_down_m);
  } else if (seen.tip.z() < rules_.hover_m) {
    step.z() = std::max(step.z(), -rules_.touch_m);
  }
  if (world.F_ext_W[2] > rules_.push_force + world.insertion_force && step.z() < 0.0)
    step.z() = 0.002;
  Twist twist = Twist::Zero();
  const double errors[6] = {step.x(), step.y(), step.z(), 0.0, 0.0, rules_.gain * turn};
  double largest = 1.0;
  for (int i = 0; i < 6; ++i) {
    if (world.action_limit[i] <= 0.0) continue;
    twist[i] = errors[i] / world.action_limit[i];
    largest = std::max(largest, std::abs(twist[i]) / speed_);
  }
  // Slow down on the last millimetres: tremor is a share of the motion, and small when still.
  twist /= largest;
  const double left = to_grasp ? seen.tip.norm() : seen.distance + (kCalmAhead - world.goal_depth);
  const double calm = std::clamp(left / 0.05, 0.25, 1.0);
  for (int i = 0; i < 6; ++i) {
    if (world.action_limit[i] > 0.0) twist[i] = std::clamp(twist[i] + calm * tremor_[i], -1.0, 1.0);
  }
  return twist;
}

double ScriptedOperator::grip(const world_state_t& world, const View& seen) {
  if (world.grasp_width <= 0.0) return 1.0;
  if (seen.leg == Leg::put_back) {
    const bool there = seen.tip.head<2>().norm() < 3.0 * rules_.reach_align_m &&
                       (seen.tip.z() < rules_.grip_m || seen.force > rules_.push_force);
    dropping_ = dropping_ || there;
    closing_ = !dropping_;
    return closing_ ? 1.0 : -1.0;
  }
  // What he lets go falls free before he takes it anew.
  if (dropping_) dropping_ = seen.gripper_width < world.grasp_width + kFreeWidth;
  // Once he closes he goes on, unless the object gets away or the fingers meet.
  const double slack = closing_ ? 2.0 : 1.0;
  const bool there = seen.tip.head<2>().norm() < slack * rules_.reach_align_m &&
                     std::abs(seen.tip.z()) < slack * rules_.grip_m &&
                     std::abs(seen.yaw) < 2.0 * slack * rules_.reach_align_rad &&
                     seen.tilt < kToppled;
  const bool empty = seen.gripper_width < world.grasp_width - kHeldWidth;
  closing_ = !dropping_ && (seen.leg == Leg::place || (seen.leg == Leg::reach && there && !empty));
  return closing_ ? 1.0 : -1.0;
}

Eigen::Vector3d ScriptedOperator::heading(const world_state_t& world, const View& seen) {
  const double off_axis = seen.tip.head<2>().norm();
  const bool hand_is_free = seen.gripper_width > world.grasp_width + kFreeWidth;
  if (seen.leg == Leg::leave) return {0.0, 0.0, hand_is_free ? rules_.reach_hover_m : 0.0};

  if (seen.leg == Leg::put_back) {
    // Up, over the place where it lay, down, and there the fingers open.
    aligned_ = false;
    stuck_steps_ = 0;
    lowest_ = 1e9;
    if (dropping_) return Eigen::Vector3d::Zero();
    const double over = rules_.reach_hover_m + world.goal_depth;
    const bool above_it = off_axis < 3.0 * rules_.reach_align_m;
    Eigen::Vector3d wanted(-seen.tip.x(), -seen.tip.y(), (above_it ? 0.0 : over) - seen.tip.z());
    if (!above_it && seen.tip.z() < 0.7 * over) wanted.head<2>() *= 0.1;
    return wanted;
  }

  if (seen.leg == Leg::reach) {
    // Over the object with open fingers, then down to it.
    const bool aligned =
        off_axis < rules_.reach_align_m && std::abs(seen.yaw) < rules_.reach_align_rad;
    if (aligned) aligned_ = true;
    if (off_axis > 3.0 * rules_.reach_align_m) aligned_ = false;
    stuck_steps_ = 0;
    lowest_ = 1e9;
    if (closing_) return Eigen::Vector3d::Zero();
    const bool down = aligned_ && hand_is_free;
    Eigen::Vector3d wanted(-seen.tip.x(), -seen.tip.y(),
                           (down ? 0.0 : rules_.reach_hover_m) - seen.tip.z());
    if (!aligned_ && seen.tip.z() < 0.5 * rules_.reach_hover_m) wanted.head<2>() *= 0.1;
    return wanted;
  }

  // Over the axis first, then down it.
  const bool inside = seen.tip.z() < -0.002 && off_axis < kInside;
  if (off_axis < rules_.align_m && std::abs(seen.yaw) < rules_.align_rad) aligned_ = true;
  if (off_axis > 5.0 * rules_.align_m && !inside) aligned_ = false;
  // What he has taken he carries well clear of everything, and comes down over the goal.
  const bool carries = world.grasp_width > 0.0 && off_axis > kOverGoal;
  const double over = carries ? clear_ : rules_.hover_m;
  const double target_z = aligned_ || inside ? -world.goal_depth : over;
  Eigen::Vector3d wanted(-seen.tip.x(), -seen.tip.y(), target_z - seen.tip.z());
  // Off the axis he stays clear of the goal, and lifts the object before he carries it over.
  if (off_axis > 0.02 && wanted.z() < 0.0 && seen.tip.z() < 0.02) wanted.z() = 0.0;
  if (off_axis > 5.0 * rules_.align_m && seen.tip.z() < 0.5 * over) wanted.head<2>() *= 0.1;

  // Stuck in the mouth: he wiggles until it falls deeper.
  if (seen.tip.z() < lowest_ - 0.0005) {
    lowest_ = seen.tip.z();
    stuck_steps_ = 0;
  } else if (aligned_ || inside) {
    ++stuck_steps_;
  }
  return wanted;
}

}  // namespace tandem
