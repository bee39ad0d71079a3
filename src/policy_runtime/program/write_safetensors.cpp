#include "policy_runtime/program/write_safetensors.h"

#include <fstream>
#include <nlohmann/json.hpp>

#include "policy_runtime/policy_error.h"

namespace tandem::policy {

void write_safetensors(const std::string& path, const std::string& name,
                       const std::vector<std::int64_t>& shape, const std::vector<float>& values) {
  const std::size_t n_bytes = values.size() * sizeof(float);
  const nlohmann::json entry = {{"dtype", "F32"}, {"shape", shape}, {"data_offsets", {0, n_bytes}}};
  std::string header = nlohmann::json{{name, entry}}.dump();
  header.resize((header.size() + 7) / 8 * 8, ' ');  // the data begins aligned
  const std::uint64_t length = header.size();

  std::ofstream out(path, std::ios::binary);
  out.write(reinterpret_cast<const char*>(&length), sizeof(length));
  out.write(header.data(), static_cast<std::streamsize>(header.size()));
  out.write(reinterpret_cast<const char*>(values.data()), static_cast<std::streamsize>(n_bytes));
  if (!out.flush()) throw PolicyError(path + ": it cannot be written. Check folder and disk.");
}

}  // namespace tandem::policy
