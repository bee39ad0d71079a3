#include "policy_runtime/file/safetensors.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string_view>

#include "policy_runtime/file/strict_json.h"
#include "policy_runtime/policy_error.h"

namespace tandem::policy {
namespace {

static_assert(std::endian::native == std::endian::little, "the file is copied, not byte-swapped");

constexpr std::uint64_t kPrefixBytes = 8;
constexpr std::size_t kMaxRank = 8;
const char kAgain[] = " Write the file again.";

std::string text(std::uint64_t value) { return std::to_string(value); }

std::string text(const std::vector<std::int64_t>& shape) {
  std::string out = "(";
  for (std::size_t i = 0; i < shape.size(); ++i) out += (i ? ", " : "") + std::to_string(shape[i]);
  return out + ")";
}

}  // namespace

SafetensorsFile::SafetensorsFile(const std::string& path) : path_(path) {
  read_bytes();
  parse_header(header_text());
  check_layout();
}

void SafetensorsFile::refuse(const std::string& sentence) const {
  throw PolicyError(path_ + ": " + sentence);
}

void SafetensorsFile::read_bytes() {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path_, error))
    refuse("there is no such file. Check the path.");
  const std::uint64_t size = std::filesystem::file_size(path_, error);
  if (error) refuse("its size cannot be read (" + error.message() + "). Check the path.");
  if (size > kMaxFileBytes) {
    refuse("it has " + text(size) + " bytes; the limit is " + text(kMaxFileBytes) +
           ". Is it a policy file?");
  }
  std::ifstream stream(path_, std::ios::binary);
  bytes_.resize(size);
  if (!stream.read(bytes_.data(), static_cast<std::streamsize>(size))) {
    refuse("reading its " + text(size) + " bytes failed. Check permissions and disk.");
  }
}

std::string_view SafetensorsFile::header_text() const {
  if (bytes_.size() < kPrefixBytes) {
    refuse("it has " + text(bytes_.size()) + " bytes and is cut off before its header." + kAgain);
  }
  std::uint64_t length = 0;
  std::memcpy(&length, bytes_.data(), kPrefixBytes);
  if (length > kMaxHeaderBytes) {
    refuse("its header claims " + text(length) + " bytes; the limit is " + text(kMaxHeaderBytes) +
           ". Is it a safetensors file?");
  }
  if (length > bytes_.size() - kPrefixBytes) {
    refuse("its header claims " + text(length) + " bytes, but only " +
           text(bytes_.size() - kPrefixBytes) + " follow: the file is cut off." + kAgain);
  }
  return {bytes_.data() + kPrefixBytes, length};
}

void SafetensorsFile::parse_header(std::string_view header) {
  data_begin_ = kPrefixBytes + header.size();
  const nlohmann::json json = parse_strict_json(header, path_ + ": the header");
  if (!json.is_object()) refuse(std::string("the header is not a JSON object.") + kAgain);

  for (const auto& [name, entry] : json.items()) {
    const std::string label = "tensor " + printable(name);
    if (!entry.is_object()) refuse(label + " is not described by a JSON object." + kAgain);

    if (name == "__metadata__") {
      for (const auto& [key, value] : entry.items()) {
        if (!value.is_string()) refuse("metadata " + printable(key) + " is not a string." + kAgain);
        metadata_[key] = value.get<std::string>();
      }
      continue;
    }

    if (entry.size() != 3 || !entry.contains("dtype") || !entry.contains("shape") ||
        !entry.contains("data_offsets")) {
      refuse(label + " must have exactly dtype, shape and data_offsets." + kAgain);
    }
    Tensor tensor;
    const auto& dtype = entry["dtype"];
    std::uint64_t size = 0;  // bytes
    if (dtype == "F32") {
      tensor.dtype = Dtype::kF32, size = 4;
    } else if (dtype == "BF16") {
      tensor.dtype = Dtype::kBF16, size = 2;
    } else if (dtype == "U8") {
      tensor.dtype = Dtype::kU8, size = 1;
    } else {
      refuse(label + " has dtype " + printable(dtype.dump()) +
             "; only F32, BF16 and U8 are supported. Save float32 parameters.");
    }

    const auto& shape = entry["shape"];
    if (!shape.is_array() || shape.size() > kMaxRank) {
      refuse(label + " needs a shape of at most " + text(kMaxRank) + " dimensions." + kAgain);
    }
    for (const auto& dimension : shape) {
      if (!dimension.is_number_unsigned() || dimension == 0 ||
          __builtin_mul_overflow(size, dimension.get<std::uint64_t>(), &size) ||
          size > kMaxFileBytes) {
        refuse(label + " has the dimension " + printable(dimension.dump()) +
               "; dimensions are at least 1 and a tensor at most " + text(kMaxFileBytes) +
               " bytes." + kAgain);
      }
      tensor.shape.push_back(dimension.get<std::int64_t>());
    }

    const auto& offsets = entry["data_offsets"];
    if (!offsets.is_array() || offsets.size() != 2 || !offsets[0].is_number_unsigned() ||
        !offsets[1].is_number_unsigned()) {
      refuse(label + " needs data_offsets of two non-negative integers." + kAgain);
    }
    tensor.begin = offsets[0].get<std::uint64_t>();
    tensor.end = offsets[1].get<std::uint64_t>();
    if (tensor.end < tensor.begin || tensor.end - tensor.begin != size) {
      refuse(label + " has the data_offsets " + text(tensor.begin) + " to " + text(tensor.end) +
             ", but its shape " + text(tensor.shape) + " needs " + text(size) + " bytes." + kAgain);
    }
    tensors_.emplace(name, std::move(tensor));
  }
}

void SafetensorsFile::check_layout() const {
  std::vector<std::pair<std::string, Tensor>> by_offset(tensors_.begin(), tensors_.end());
  std::sort(by_offset.begin(), by_offset.end(),
            [](const auto& a, const auto& b) { return a.second.begin < b.second.begin; });

  std::uint64_t covered = 0;
  for (const auto& [name, tensor] : by_offset) {
    if (tensor.begin != covered) {
      refuse("tensor " + printable(name) + " begins at byte " + text(tensor.begin) +
             (tensor.begin < covered ? " and overlaps the one that ends at "
                                     : " and leaves a hole after ") +
             text(covered) + "; tensors must follow each other." + kAgain);
    }
    covered = tensor.end;
  }
  const std::uint64_t available = bytes_.size() - data_begin_;
  if (covered > available) {
    refuse("the tensors need " + text(covered) + " bytes, but only " + text(available) +
           " follow the header: the file is cut off." + kAgain);
  }
  if (covered < available) {
    refuse(text(available - covered) + " bytes follow the last tensor; none may." + kAgain);
  }
}

const std::string& SafetensorsFile::metadata(const std::string& key) const {
  const auto found = metadata_.find(key);
  if (found == metadata_.end()) {
    refuse("metadata " + printable(key) + " is missing. Write the file with the current learner.");
  }
  return found->second;
}

const SafetensorsFile::Tensor& SafetensorsFile::find(const std::string& name) const {
  const auto found = tensors_.find(name);
  if (found == tensors_.end()) {
    refuse("tensor " + printable(name) + " is missing. Write the file with the current learner.");
  }
  return found->second;
}

const std::vector<std::int64_t>& SafetensorsFile::shape(const std::string& name) const {
  return find(name).shape;
}

void SafetensorsFile::check_shape(const std::string& name,
                                  const std::vector<std::int64_t>& shape) const {
  const Tensor& tensor = find(name);
  if (tensor.shape != shape) {
    refuse("tensor " + printable(name) + " has the shape " + text(tensor.shape) +
           "; the metadata asks for " + text(shape) + ". Write config and tensors of one network.");
  }
}

std::vector<float> SafetensorsFile::take(const std::string& name,
                                         const std::vector<std::int64_t>& shape) {
  check_shape(name, shape);
  const Tensor& tensor = find(name);
  const char* bytes = bytes_.data() + data_begin_ + tensor.begin;
  const std::size_t n_bytes = tensor.end - tensor.begin;
  taken_.insert(name);

  std::vector<float> values;
  switch (tensor.dtype) {
    case Dtype::kF32:
      values.resize(n_bytes / sizeof(float));
      std::memcpy(values.data(), bytes, n_bytes);
      break;
    case Dtype::kBF16:
      values.resize(n_bytes / sizeof(std::uint16_t));
      for (std::size_t i = 0; i < values.size(); ++i) {
        std::uint16_t upper = 0;
        std::memcpy(&upper, bytes + i * sizeof(upper), sizeof(upper));
        values[i] = std::bit_cast<float>(std::uint32_t{upper} << 16);
      }
      break;
    case Dtype::kU8:
      refuse("tensor " + printable(name) + " has dtype U8; numbers are needed here." + kAgain);
  }
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (!std::isfinite(values[i])) {
      refuse("tensor " + printable(name) + " is not finite at element " + text(i) +
             ". The training that wrote it has diverged; use an earlier policy.");
    }
  }
  return values;
}

std::vector<std::uint8_t> SafetensorsFile::take_bytes(const std::string& name,
                                                      const std::vector<std::int64_t>& shape) {
  check_shape(name, shape);
  const Tensor& tensor = find(name);
  if (tensor.dtype != Dtype::kU8) {
    refuse("tensor " + printable(name) + " must have dtype U8: it holds images." + kAgain);
  }
  taken_.insert(name);
  const char* bytes = bytes_.data() + data_begin_;
  return {bytes + tensor.begin, bytes + tensor.end};
}

void SafetensorsFile::refuse_unused() const {
  for (const auto& [name, tensor] : tensors_) {
    if (!taken_.contains(name)) {
      refuse("tensor " + printable(name) +
             " is unknown or unused by the network that the metadata describes. Write config and "
             "tensors of one network.");
    }
  }
}

}  // namespace tandem::policy
