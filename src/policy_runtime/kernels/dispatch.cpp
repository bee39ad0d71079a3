#include <algorithm>
#include <atomic>
#include <bit>
#include <cctype>
#include <cstdlib>

#include "policy_runtime/kernels/kernels.h"
#include "policy_runtime/policy_error.h"

namespace tandem::policy {
namespace {

std::atomic<const Kernels*> in_use{nullptr};

bool same(std::string_view a, std::string_view b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](unsigned char x, unsigned char y) {
    return std::tolower(x) == std::tolower(y);
  });
}

const Kernels& best() { return simd_kernels().empty() ? scalar_kernels() : simd_kernels().front(); }

const Kernels& find(std::string_view name) {
  if (same(name, "scalar")) return scalar_kernels();
  if (same(name, "simd") && !simd_kernels().empty()) return simd_kernels().front();
  for (const Kernels& candidate : simd_kernels()) {
    if (same(name, candidate.name)) return candidate;
  }
  std::string known;
  for (const std::string& each : available_kernels()) known += each + ", ";
  throw PolicyError("TANDEM_KERNEL or force_kernel asks for " + printable(name) +
                    "; this machine runs " + known + "simd (the best). Choose one of these.");
}

}  // namespace

const Kernels& kernels() {
  if (const Kernels* chosen = in_use.load(std::memory_order_acquire)) return *chosen;
  const char* wanted = std::getenv("TANDEM_KERNEL");
  const Kernels& chosen = (wanted && *wanted) ? find(wanted) : best();
  const Kernels* none = nullptr;
  in_use.compare_exchange_strong(none, &chosen);
  return *in_use.load(std::memory_order_acquire);
}

std::string kernel_name() { return kernels().name; }

std::vector<std::string> available_kernels() {
  std::vector<std::string> names;
  for (const Kernels& each : simd_kernels()) names.emplace_back(each.name);
  names.emplace_back("scalar");
  return names;
}

void force_kernel(std::string_view name) { in_use.store(&find(name), std::memory_order_release); }

bool activation_from_name(std::string_view name, Activation& activation) {
  constexpr std::pair<std::string_view, Activation> kNames[] = {{"identity", Activation::kIdentity},
                                                                {"relu", Activation::kRelu},
                                                                {"tanh", Activation::kTanh},
                                                                {"gelu", Activation::kGelu}};
  for (const auto& [known, value] : kNames) {
    if (name != known) continue;
    activation = value;
    return true;
  }
  return false;
}

void pack(const float* row_major, PackedMatrix& matrix, float* packed) {
  const bool half = matrix.precision == Precision::kBfloat16;
  auto* packed_bf16 = reinterpret_cast<std::uint16_t*>(packed);
  for (int row = 0; row < matrix.rows; ++row) {
    const std::size_t panel =
        std::size_t(row / kPadding) * matrix.padded_columns() * kPadding + row % kPadding;
    for (int column = 0; column < matrix.columns; ++column) {
      const float value = row_major[std::size_t(row) * matrix.columns + column];
      const std::size_t index = panel + std::size_t(column) * kPadding;
      if (half) {
        packed_bf16[index] = static_cast<std::uint16_t>(std::bit_cast<std::uint32_t>(value) >> 16);
      } else {
        packed[index] = value;
      }
    }
  }
  matrix.data = half ? nullptr : packed;
  matrix.data_bf16 = half ? packed_bf16 : nullptr;
}

}  // namespace tandem::policy
