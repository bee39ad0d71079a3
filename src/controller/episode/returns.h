#pragma once

#include <cstddef>
#include <vector>

namespace tandem {

/// G_t = sum over k < T - t of gamma^k r_{t+k}: Monte Carlo, no bootstrap, a time-out counts 0
/// (paper, section III-B).
/// @param rewards r_0 ... r_{T-1}. @returns G_0 ... G_{T-1}.
inline std::vector<double> discounted_returns(const std::vector<double>& rewards, double gamma) {
  std::vector<double> returns(rewards.size());
  double tail = 0.0;
  for (size_t t = rewards.size(); t-- > 0;) returns[t] = tail = rewards[t] + gamma * tail;
  return returns;
}

}  // namespace tandem
