#pragma once

#include <algorithm>
#include <chrono>
#include <functional>
#include <iostream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

namespace tandem::bench {

/// Evaluates example i of the policy file; chunk (h A).
using Evaluate = std::function<void(int example, float* chunk)>;

/// A contender's side of `./tandem bench policy`, which keeps several such programs and lets them
/// work in turns. Says what it is in a first line, then answers each line until stdin ends:
///
///   run N    N evaluations, example after example -> a JSON list of N microseconds. Before them a
///            tenth as many that do not count: another program had the caches.
///   chunk I  the chunk of example I -> a JSON list of h A numbers
inline int serve(const nlohmann::json& about, int examples, int chunk_size,
                 const Evaluate& evaluate) {
  using Clock = std::chrono::steady_clock;
  std::vector<float> chunk(chunk_size);
  std::vector<double> microseconds;
  int next = 0;
  const auto step = [&] {
    const auto begin = Clock::now();
    evaluate(next, chunk.data());
    const std::chrono::duration<double, std::micro> took = Clock::now() - begin;
    next = (next + 1) % examples;
    return took.count();
  };

  std::cout << about.dump() << std::endl;
  for (std::string line; std::getline(std::cin, line);) {
    std::istringstream words(line);
    std::string order;
    int n = -1;
    words >> order >> n;
    if (order == "run" && n > 0) {
      microseconds.resize(n);
      for (int i = 0; i < std::max(1, n / 10); ++i) step();
      for (double& each : microseconds) each = step();
      std::cout << nlohmann::json(microseconds).dump() << std::endl;
    } else if (order == "chunk" && n >= 0 && n < examples) {
      evaluate(n, chunk.data());
      std::cout << nlohmann::json(chunk).dump() << std::endl;
    } else {
      std::cerr << "\"" << line << "\" is neither run N nor chunk I.\n";
      return 2;
    }
  }
  return 0;
}

}  // namespace tandem::bench
