#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace tandem::policy {

/// Writes one float32 tensor as a safetensors file. @throws PolicyError when it can't be written.
void write_safetensors(const std::string& path, const std::string& name,
                       const std::vector<std::int64_t>& shape, const std::vector<float>& values);

}  // namespace tandem::policy
