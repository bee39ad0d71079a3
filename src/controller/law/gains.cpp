#include "controller/law/gains.h"

#include <cmath>
#include <sstream>

namespace tandem {
namespace {

constexpr double kRounding = 1e-9;  // share of the largest entry

const char* const kAxes[6] = {"x", "y", "z", "rx", "ry", "rz"};

Twist limits(double linear, double angular) {
  Twist v;
  v << linear, linear, linear, angular, angular, angular;
  return v;
}

Twist stiffness_limit() { return limits(gain_limit::kStiffness, gain_limit::kAngularStiffness); }
Twist damping_limit() { return limits(gain_limit::kDamping, gain_limit::kAngularDamping); }

// What is wrong with a gain matrix as a clause that follows its name; empty if nothing is.
std::string fault_of(const Matrix6& matrix, const Twist& diagonal_limit) {
  std::ostringstream out;
  if (!matrix.allFinite()) return "holds a number that is not finite";
  for (int i = 0; i < 6; ++i) {
    if (!(matrix(i, i) >= 0.0 && matrix(i, i) <= diagonal_limit[i])) {
      out << "is " << matrix(i, i) << " on axis " << kAxes[i] << "; it must be in [0, "
          << diagonal_limit[i] << "]";
      return out.str();
    }
  }
  const double rounding = kRounding * matrix.cwiseAbs().maxCoeff();
  for (int i = 0; i < 6; ++i) {
    for (int j = i + 1; j < 6; ++j) {
      if (std::abs(matrix(i, j) - matrix(j, i)) > rounding) {
        out << "is not symmetric: " << matrix(i, j) << " at " << kAxes[i] << ", " << kAxes[j]
            << " and " << matrix(j, i) << " at " << kAxes[j] << ", " << kAxes[i]
            << "; make them equal";
        return out.str();
      }
    }
  }
  const double smallest = Eigen::SelfAdjointEigenSolver<Matrix6>(matrix, Eigen::EigenvaluesOnly)
                              .eigenvalues()
                              .minCoeff();
  if (smallest < -rounding) {
    out << "has the eigenvalue " << smallest
        << "; all must be >= 0, or the law would drive the arm away instead of back";
    return out.str();
  }
  return "";
}

Matrix6 symmetric(const Matrix6& matrix) { return 0.5 * (matrix + matrix.transpose()); }

Matrix6 read_matrix(Section& section, const std::string& key, const Twist& diagonal_limit) {
  const double largest = diagonal_limit.maxCoeff();
  Matrix6 matrix = Matrix6::Zero();
  if (section.size(key) == 36) {
    const std::vector<double> entries = section.numbers(key, 36, -largest, largest);
    matrix = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>::Map(entries.data());
  } else {
    matrix.diagonal() = Twist::Map(section.numbers(key, 6, 0.0, largest).data());
  }
  const std::string fault = fault_of(matrix, diagonal_limit);
  if (!fault.empty()) throw ScenarioError(section.place(key) + " " + fault + ".");
  return symmetric(matrix);
}

Twist read_clip(Section& section, const std::string& key) {
  return Twist::Map(section.numbers(key, 6, 0.0, gain_limit::kClip).data());
}

void exclude(Section& section, const std::string& one, const std::string& other) {
  if (section.has(one) && section.has(other)) {
    throw ScenarioError(section.place(other) + " says again what `" + one +
                        "` says; remove one of the two.");
  }
}

Matrix6 from_rows(const double (&rows)[6][6]) {
  return Eigen::Matrix<double, 6, 6, Eigen::RowMajor>::Map(&rows[0][0]);
}

void to_rows(const Matrix6& matrix, double (&rows)[6][6]) {
  Eigen::Matrix<double, 6, 6, Eigen::RowMajor>::Map(&rows[0][0]) = matrix;
}

std::string clip_fault(const char* name, const double (&clip)[6]) {
  for (int i = 0; i < 6; ++i) {
    if (!(clip[i] >= 0.0 && clip[i] <= gain_limit::kClip)) {
      std::ostringstream out;
      out << name << " is " << clip[i] << " on axis " << kAxes[i] << "; it must be in [0, "
          << gain_limit::kClip << "]";
      return out.str();
    }
  }
  return "";
}

}  // namespace

Matrix6 damping_from_ratio(const Matrix6& stiffness, const Twist& inertia, double ratio) {
  const Twist root = inertia.cwiseSqrt();
  const Twist inverse = root.cwiseInverse();
  const Matrix6 scaled = inverse.asDiagonal() * stiffness * inverse.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Matrix6> solver(scaled);
  const Matrix6 frequency = solver.eigenvectors() *
                            solver.eigenvalues().cwiseMax(0.0).cwiseSqrt().asDiagonal() *
                            solver.eigenvectors().transpose();
  return symmetric(2.0 * ratio * (root.asDiagonal() * frequency * root.asDiagonal()));
}

ImpedanceGains read_gains(Section section) {
  ImpedanceGains gains;
  gains.tool_axes = section.choice("axes", {"base", "tool"}) == "tool";
  gains.stiffness = read_matrix(section, "stiffness", stiffness_limit());
  gains.apparent_inertia = Twist::Map(section.numbers("apparent_inertia", 6, 0.001, 50.0).data());

  exclude(section, "damping_ratio", "damping");
  if (section.has("damping")) {
    gains.damping = read_matrix(section, "damping", damping_limit());
  } else {
    const double ratio = section.number("damping_ratio", 0.0, gain_limit::kDampingRatio);
    gains.damping = damping_from_ratio(gains.stiffness, gains.apparent_inertia, ratio);
    const std::string fault = fault_of(gains.damping, damping_limit());
    if (!fault.empty())
      throw ScenarioError(section.place("damping_ratio") + ": the damping that follows " + fault +
                          ".");
  }

  exclude(section, "error_clip", "error_clip_low");
  exclude(section, "error_clip", "error_clip_high");
  if (section.has("error_clip_low") || section.has("error_clip_high")) {
    gains.clip_low = read_clip(section, "error_clip_low");
    gains.clip_high = read_clip(section, "error_clip_high");
  } else {
    gains.clip_low = gains.clip_high = read_clip(section, "error_clip");
  }

  gains.posture = JointVector::Map(section.numbers("posture", 7, -3.8, 3.8).data());
  gains.posture_stiffness = section.number("posture_stiffness", 0.0, 100.0);
  gains.posture_torque_limit = section.number("posture_torque_limit", 0.0, 20.0);
  section.finish();
  return gains;
}

std::string gains_from(const impedance_gains_t& message, const ImpedanceGains& present,
                       ImpedanceGains& gains) {
  if (message.tool_axes != 0 && message.tool_axes != 1)
    return "tool_axes is " + std::to_string(message.tool_axes) + "; it must be 0 or 1";
  ImpedanceGains wanted = present;
  wanted.tool_axes = message.tool_axes == 1;

  wanted.stiffness = from_rows(message.stiffness);
  std::string fault = fault_of(wanted.stiffness, stiffness_limit());
  if (!fault.empty()) return "stiffness " + fault;
  wanted.stiffness = symmetric(wanted.stiffness);

  if (!(message.damping_ratio <= gain_limit::kDampingRatio)) {
    std::ostringstream out;
    out << "damping_ratio is " << message.damping_ratio << "; it must be in [0, "
        << gain_limit::kDampingRatio << "], or negative to give `damping`";
    return out.str();
  }
  const bool by_ratio = message.damping_ratio >= 0.0;
  wanted.damping = by_ratio ? damping_from_ratio(wanted.stiffness, wanted.apparent_inertia,
                                                 message.damping_ratio)
                            : from_rows(message.damping);
  fault = fault_of(wanted.damping, damping_limit());
  if (!fault.empty())
    return (by_ratio ? "damping that follows from damping_ratio " : "damping ") + fault;
  wanted.damping = symmetric(wanted.damping);

  fault = clip_fault("error_clip_low", message.error_clip_low);
  if (fault.empty()) fault = clip_fault("error_clip_high", message.error_clip_high);
  if (!fault.empty()) return fault;
  wanted.clip_low = Twist::Map(message.error_clip_low);
  wanted.clip_high = Twist::Map(message.error_clip_high);
  gains = wanted;
  return "";
}

impedance_gains_t to_message(const ImpedanceGains& gains, int64_t utime) {
  impedance_gains_t message;
  message.utime = utime;
  message.tool_axes = gains.tool_axes ? 1 : 0;
  to_rows(gains.stiffness, message.stiffness);
  message.damping_ratio = -1.0;
  to_rows(gains.damping, message.damping);
  Twist::Map(message.error_clip_low) = gains.clip_low;
  Twist::Map(message.error_clip_high) = gains.clip_high;
  return message;
}

}  // namespace tandem
