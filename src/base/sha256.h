#pragma once

#include <cstddef>
#include <string>

namespace tandem {

/// SHA-256 over pieces, as lower-case hex.
class Sha256 {
 public:
  Sha256();
  ~Sha256();
  Sha256(const Sha256&) = delete;
  Sha256& operator=(const Sha256&) = delete;

  void add(const void* data, size_t n_bytes);
  std::string hex();  ///< ends the digest; call once

 private:
  void* context_;
};

}  // namespace tandem
