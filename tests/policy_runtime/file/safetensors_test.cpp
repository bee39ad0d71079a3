#include "policy_runtime/file/safetensors.h"

#include <gtest/gtest.h>

#include <limits>

#include "policy_runtime/policy_error.h"
#include "policy_runtime/policy_file.h"

namespace tandem::policy::testing {
namespace {

std::string entry(const std::string& name, const std::string& shape, const std::string& offsets,
                  const std::string& dtype = "\"F32\"") {
  return "\"" + name + "\":{\"dtype\":" + dtype + ",\"shape\":" + shape +
         ",\"data_offsets\":" + offsets + "}";
}

// The refusal of a file with this header and so many data bytes.
std::string refused(const std::string& header, std::size_t data_bytes) {
  return refusal(write_file(safetensors(header, std::string(data_bytes, '\0'))));
}

TEST(Safetensors, GivesBackWhatWasWritten) {
  const std::string header = "{" + entry("a", "[2,3]", "[0,24]") + "," +
                             entry("b", "[1]", "[24,28]") + ",\"__metadata__\":{\"k\":\"v\"}}   ";
  const float values[7] = {1, 2, 3, 4, 5, 6, -7.5f};
  SafetensorsFile file(
      write_file(safetensors(header, std::string(reinterpret_cast<const char*>(values), 28))));
  EXPECT_EQ(file.metadata("k"), "v");
  EXPECT_EQ(file.take("a", {2, 3}), (std::vector<float>{1, 2, 3, 4, 5, 6}));
  EXPECT_THROW(file.refuse_unused(), PolicyError);
  EXPECT_EQ(file.take("b", {1}), std::vector<float>{-7.5f});
  EXPECT_NO_THROW(file.refuse_unused());
}

TEST(Safetensors, RefusesAFileThatIsNotThere) {
  EXPECT_TRUE(says(refusal("/nonexistent/policy.safetensors"), "no such file"));
  EXPECT_TRUE(says(refusal(::testing::TempDir()), "no such file"));
}

TEST(Safetensors, RefusesEveryTruncation) {
  const std::string bytes = safetensors(make_mlp({}).header(), make_mlp({}).data());
  for (const std::size_t length :
       {0ul, 1ul, 7ul, 8ul, 9ul, 500ul, bytes.size() / 2, bytes.size() - 1}) {
    EXPECT_TRUE(says(refusal(write_file(bytes.substr(0, length))), "cut off")) << length;
  }
}

TEST(Safetensors, RefusesAHugeHeaderBeforeAllocatingIt) {
  std::string bytes(64, '\xff');  // a length of 2^64 - 1
  EXPECT_TRUE(says(refusal(write_file(bytes)), "limit is 1048576"));
}

TEST(Safetensors, RefusesOverlapHoleAndTrailingBytes) {
  EXPECT_TRUE(
      says(refused("{" + entry("a", "[2]", "[0,8]") + "," + entry("b", "[2]", "[4,12]") + "}", 12),
           "overlaps"));
  EXPECT_TRUE(
      says(refused("{" + entry("a", "[2]", "[0,8]") + "," + entry("b", "[2]", "[0,8]") + "}", 8),
           "overlaps"));
  EXPECT_TRUE(
      says(refused("{" + entry("a", "[2]", "[0,8]") + "," + entry("b", "[2]", "[12,20]") + "}", 20),
           "hole"));
  EXPECT_TRUE(says(refused("{" + entry("a", "[2]", "[4,12]") + "}", 12), "hole"));
  EXPECT_TRUE(says(refused("{" + entry("a", "[2]", "[0,8]") + "}", 12), "4 bytes follow"));
}

TEST(Safetensors, RefusesOffsetsThatOverflowOrContradictTheShape) {
  const std::string most = "18446744073709551615";
  EXPECT_TRUE(says(refused("{" + entry("a", "[2]", "[0,12]") + "}", 12), "needs 8 bytes"));
  EXPECT_TRUE(says(refused("{" + entry("a", "[2]", "[8,0]") + "}", 8), "needs 8 bytes"));
  EXPECT_TRUE(says(refused("{" + entry("a", "[2]", "[" + most + ",7]") + "}", 8), "needs 8 bytes"));
  EXPECT_TRUE(
      says(refused("{" + entry("a", "[4611686018427387904,4]", "[0,0]") + "}", 0), "dimension"));
  EXPECT_TRUE(says(refused("{" + entry("a", "[" + most + "]", "[0,8]") + "}", 8), "dimension"));
  EXPECT_TRUE(says(refused("{" + entry("a", "[" + most + "0]", "[0,8]") + "}", 8), "dimension"));
  EXPECT_TRUE(says(refused("{" + entry("a", "[-2]", "[0,8]") + "}", 8), "dimension"));
  EXPECT_TRUE(says(refused("{" + entry("a", "[0]", "[0,0]") + "}", 0), "dimension"));
  EXPECT_TRUE(says(refused("{" + entry("a", "[2.0]", "[0,8]") + "}", 8), "dimension"));
  EXPECT_TRUE(says(refused("{" + entry("a", "[2]", "[0,8.0]") + "}", 8), "data_offsets"));
  EXPECT_TRUE(
      says(refused("{" + entry("a", "[1,1,1,1,1,1,1,1,1]", "[0,4]") + "}", 4), "8 dimensions"));
}

TEST(Safetensors, RefusesOtherDtypes) {
  for (const std::string dtype : {"\"F64\"", "\"I8\"", "\"f32\"", "3", "null"}) {
    EXPECT_TRUE(
        says(refused("{" + entry("a", "[2]", "[0,8]", dtype) + "}", 8), "only F32, BF16 and U8"));
  }
}

TEST(Safetensors, WidensBfloat16AndKeepsBytes) {
  const std::string header = "{" + entry("half", "[2]", "[0,4]", "\"BF16\"") + "," +
                             entry("image", "[3]", "[4,7]", "\"U8\"") + "}";
  const std::string data("\x80\x3f\x20\xc0\x00\x7f\xff", 7);  // 1.0, -2.5; 0, 127, 255
  SafetensorsFile file(write_file(safetensors(header, data)));
  EXPECT_TRUE(file.is_bfloat16("half"));
  EXPECT_EQ(file.take("half", {2}), (std::vector<float>{1.0f, -2.5f}));
  EXPECT_EQ(file.take_bytes("image", {3}), (std::vector<std::uint8_t>{0, 127, 255}));
  file.refuse_unused();
  EXPECT_THROW(file.take("image", {3}), PolicyError) << "bytes are not numbers";
  EXPECT_THROW(file.take_bytes("half", {2}), PolicyError) << "numbers are not bytes";
}

TEST(Safetensors, RefusesDuplicateKeysAtEveryLevel) {
  const std::string a = entry("a", "[1]", "[0,4]");
  EXPECT_TRUE(says(refused("{" + a + "," + a + "}", 4), "\"a\" twice"));
  EXPECT_TRUE(
      says(refused(R"({"a":{"dtype":"F32","dtype":"F32","shape":[1],"data_offsets":[0,4]}})", 4),
           "\"dtype\" twice"));
  EXPECT_TRUE(says(refused(R"({"__metadata__":{"k":"1","k":"2"}})", 0), "\"k\" twice"));
}

TEST(Safetensors, RefusesHostileJson) {
  EXPECT_TRUE(says(refused("", 0), "not valid JSON"));
  EXPECT_TRUE(says(refused("{", 0), "not valid JSON"));
  EXPECT_TRUE(says(refused("{} {}", 0), "not valid JSON"));
  EXPECT_TRUE(says(refused("{\"a\xff\":1}", 0), "not valid JSON"));
  EXPECT_TRUE(says(refused(std::string("{}\0", 3), 0), "not valid JSON"));
  EXPECT_TRUE(says(refused(std::string(1000000, '['), 0), "nests deeper"));
  EXPECT_TRUE(says(refused("[]", 0), "not a JSON object"));
  EXPECT_TRUE(says(refused("1e999", 0), "not"));
  EXPECT_TRUE(says(refused(R"({"a":1})", 0), "not described by a JSON object"));
  EXPECT_TRUE(says(refused(R"({"a":{"dtype":"F32","shape":[1]}})", 4), "exactly"));
  EXPECT_TRUE(says(refused(R"({"a":{"dtype":"F32","shape":[1],"data_offsets":[0,4],"x":1}})", 4),
                   "exactly"));
  EXPECT_TRUE(says(refused(R"({"__metadata__":{"k":1}})", 0), "not a string"));
  EXPECT_TRUE(says(refused(R"({"__metadata__":"k"})", 0), "not described"));
  EXPECT_TRUE(
      says(refused("{" + entry("a\\u0007\\n" + std::string(500, 'z'), "[3]", "[0,4]") + "}", 4),
           "\"a??zzz"));  // control characters stay out of terminals and logs
}

TEST(Safetensors, RefusesValuesThatAreNotFinite) {
  for (const float bad :
       {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(),
        -std::numeric_limits<float>::infinity()}) {
    for (const auto& [name, unused] : make_mlp({}).tensors) {
      PolicyFile file = make_mlp({});
      file.tensors[name].values.back() = bad;
      EXPECT_TRUE(says(refusal(write_file(file)), "\"" + name + "\" is not finite at element"));
    }
  }
}

}  // namespace
}  // namespace tandem::policy::testing
