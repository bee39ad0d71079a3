#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <string_view>
#include <vector>

namespace tandem::policy {

/// A safetensors file, read strictly: 8 bytes little-endian header length, JSON header, tensor
/// bytes.
///
/// The constructor checks the whole structure before it believes any size in it: header length
/// against the file, no duplicate key, dtype F32, BF16 or U8, sizes without overflow, offsets that
/// cover the data exactly once, in order, without hole. Tensors are then taken by name and shape;
/// what nobody took is refused at the end. Not thread-safe.
class SafetensorsFile {
 public:
  static constexpr std::uint64_t kMaxFileBytes = std::uint64_t{1} << 30;
  static constexpr std::uint64_t kMaxHeaderBytes = std::uint64_t{1} << 20;

  /// @throws PolicyError when the file cannot be read or breaks a rule above.
  explicit SafetensorsFile(const std::string& path);

  const std::string& path() const { return path_; }
  const std::map<std::string, std::string>& metadata() const { return metadata_; }

  /// The value of a metadata key. @throws PolicyError when there is none.
  const std::string& metadata(const std::string& key) const;

  /// Whether there is a tensor of that name.
  bool contains(const std::string& name) const { return tensors_.contains(name); }

  /// The shape of a tensor. @throws PolicyError when there is none of that name.
  const std::vector<std::int64_t>& shape(const std::string& name) const;

  /// @throws PolicyError when the tensor is missing or has another shape.
  void check_shape(const std::string& name, const std::vector<std::int64_t>& shape) const;

  /// Whether a tensor's numbers are stored as bfloat16. @throws PolicyError when there is none.
  bool is_bfloat16(const std::string& name) const { return find(name).dtype == Dtype::kBF16; }

  /// The values of a tensor (F32, or BF16 widened), row-major. @throws PolicyError when it is
  /// missing, of another shape or dtype, or not finite.
  std::vector<float> take(const std::string& name, const std::vector<std::int64_t>& shape);

  /// The bytes of a U8 tensor, row-major. @throws PolicyError when it is missing, of another shape
  /// or dtype.
  std::vector<std::uint8_t> take_bytes(const std::string& name,
                                       const std::vector<std::int64_t>& shape);

  /// @throws PolicyError naming the first tensor that nobody took.
  void refuse_unused() const;

 private:
  enum class Dtype { kF32, kBF16, kU8 };
  struct Tensor {
    Dtype dtype;
    std::vector<std::int64_t> shape;
    std::uint64_t begin, end;  // bytes, from the end of the header
  };

  [[noreturn]] void refuse(const std::string& sentence) const;
  void read_bytes();
  std::string_view header_text() const;
  void parse_header(std::string_view text);
  void check_layout() const;
  const Tensor& find(const std::string& name) const;

  std::string path_;
  std::vector<char> bytes_;     // the whole file
  std::size_t data_begin_ = 0;  // where the tensor bytes start
  std::map<std::string, std::string> metadata_;
  std::map<std::string, Tensor> tensors_;
  std::set<std::string> taken_;
};

}  // namespace tandem::policy
