/// What one core of this machine can do at best: reading memory by size of the working set, and
/// arithmetic. `./tandem bench policy` divides a policy's bytes and operations by these figures.
///
///   tandem_machine_limits BYTES...     -> {"instruction_set", "gflops", "gbytes_per_s": {BYTES:
///   ...}}
///
/// Reading: a float sum over a buffer of that many bytes again and again, with the widest vectors,
/// so that it stays in whatever cache holds it. Arithmetic: independent fused multiply-adds in
/// registers, two operations each. Of many short measurements the best counts: it is a limit.

// Highway compiles this file once per instruction set.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <new>
#include <nlohmann/json.hpp>
#include <string>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "policy/machine_limits.cpp"
// foreach_target.h must come first
// clang-format off
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace tandem::bench {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

constexpr hn::ScalableTag<float> d;
using V = hn::Vec<decltype(d)>;

// Eight loads a turn, each to a sum of its own. floats is a multiple of 8 registers of any width.
float Sum(const float* HWY_RESTRICT x, size_t floats) {
  const size_t lanes = hn::Lanes(d);
  V s0 = hn::Zero(d), s1 = s0, s2 = s0, s3 = s0, s4 = s0, s5 = s0, s6 = s0, s7 = s0;
  for (const float* end = x + floats; x != end; x += 8 * lanes) {
    s0 = hn::Add(s0, hn::Load(d, x));
    s1 = hn::Add(s1, hn::Load(d, x + lanes));
    s2 = hn::Add(s2, hn::Load(d, x + 2 * lanes));
    s3 = hn::Add(s3, hn::Load(d, x + 3 * lanes));
    s4 = hn::Add(s4, hn::Load(d, x + 4 * lanes));
    s5 = hn::Add(s5, hn::Load(d, x + 5 * lanes));
    s6 = hn::Add(s6, hn::Load(d, x + 6 * lanes));
    s7 = hn::Add(s7, hn::Load(d, x + 7 * lanes));
  }
  s0 =
      hn::Add(hn::Add(hn::Add(s0, s1), hn::Add(s2, s3)), hn::Add(hn::Add(s4, s5), hn::Add(s6, s7)));
  return hn::GetLane(hn::SumOfLanes(d, s0));
}

// Ten chains, enough for two units with a latency of five; returns the operations done.
double MultiplyAdd(size_t turns, float* result) {
  const V m = hn::Set(d, 0.999f), c = hn::Set(d, 0.001f);
  V a0 = hn::Set(d, *result), a1 = a0, a2 = a0, a3 = a0, a4 = a0;
  V a5 = a0, a6 = a0, a7 = a0, a8 = a0, a9 = a0;
  for (size_t turn = 0; turn < turns; ++turn) {
    a0 = hn::MulAdd(a0, m, c);
    a1 = hn::MulAdd(a1, m, c);
    a2 = hn::MulAdd(a2, m, c);
    a3 = hn::MulAdd(a3, m, c);
    a4 = hn::MulAdd(a4, m, c);
    a5 = hn::MulAdd(a5, m, c);
    a6 = hn::MulAdd(a6, m, c);
    a7 = hn::MulAdd(a7, m, c);
    a8 = hn::MulAdd(a8, m, c);
    a9 = hn::MulAdd(a9, m, c);
  }
  a0 = hn::Add(hn::Add(hn::Add(a0, a1), hn::Add(a2, a3)),
               hn::Add(hn::Add(a4, a5), hn::Add(hn::Add(a6, a7), hn::Add(a8, a9))));
  *result = hn::GetLane(hn::SumOfLanes(d, a0));
  return 2.0 * 10.0 * static_cast<double>(hn::Lanes(d)) * static_cast<double>(turns);
}

const char* InstructionSet() { return hwy::TargetName(HWY_TARGET); }

}  // namespace HWY_NAMESPACE
}  // namespace tandem::bench
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace tandem::bench {
namespace {

HWY_EXPORT(Sum);
HWY_EXPORT(MultiplyAdd);
HWY_EXPORT(InstructionSet);

constexpr double kShort = 0.002, kLong = 0.15;  // s: one measurement, and all of one kind
volatile float sink;                            // keeps the work

double seconds(const std::function<void()>& work) {
  const auto begin = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

/// The highest rate (amount per second) of repeated measurements; work does `amount` each time.
double best_rate(double amount, const std::function<void()>& work) {
  work();
  const int repeats = std::max(1, static_cast<int>(kShort / std::max(seconds(work), 1e-9)));
  double best = 0.0;
  for (double spent = 0.0; spent < kLong;) {
    const double took = seconds([&] {
      for (int i = 0; i < repeats; ++i) work();
    });
    best = std::max(best, repeats * amount / took);
    spent += took;
  }
  return best;
}

double gbytes_per_s(std::size_t bytes) {
  constexpr std::size_t kBlock = 8 * 64;  // 8 registers of AVX-512, so of any
  const std::size_t rounded = (bytes + kBlock - 1) / kBlock * kBlock;
  const std::size_t floats = rounded / sizeof(float);
  constexpr std::align_val_t kAlignment{64};
  const auto release = [&](float* block) { ::operator delete[](block, kAlignment); };
  const std::unique_ptr<float[], decltype(release)> buffer(
      static_cast<float*>(::operator new[](rounded, kAlignment)), release);
  std::fill(buffer.get(), buffer.get() + floats, 1.0f);
  return 1e-9 * best_rate(static_cast<double>(rounded),
                          [&] { sink = HWY_DYNAMIC_DISPATCH(Sum)(buffer.get(), floats); });
}

double gflops() {
  constexpr std::size_t kTurns = 10'000;
  float x = 1.0f;
  const double operations = HWY_DYNAMIC_DISPATCH(MultiplyAdd)(kTurns, &x);
  return 1e-9 * best_rate(operations, [&] {
           float start = 1.0f;
           HWY_DYNAMIC_DISPATCH(MultiplyAdd)(kTurns, &start);
           sink = start;
         });
}

}  // namespace
}  // namespace tandem::bench

int main(int argc, char** argv) {
  using namespace tandem::bench;
  nlohmann::ordered_json found;
  found["instruction_set"] = HWY_DYNAMIC_DISPATCH(InstructionSet)();
  found["gflops"] = gflops();
  found["gbytes_per_s"] = nlohmann::ordered_json::object();
  for (int i = 1; i < argc; ++i) {
    char* end = nullptr;
    const unsigned long long bytes = std::strtoull(argv[i], &end, 10);
    if (*end != '\0' || bytes == 0 || bytes > (1ull << 32)) {
      std::fprintf(stderr, "usage: tandem_machine_limits BYTES...; %s is no size up to 4 GiB.\n",
                   argv[i]);
      return 2;
    }
    found["gbytes_per_s"][argv[i]] = gbytes_per_s(bytes);
  }
  std::cout << found.dump() << std::endl;
  return 0;
}
#endif
