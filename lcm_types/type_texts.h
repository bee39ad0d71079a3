#pragma once

#include <string>
#include <vector>

namespace tandem {

/// A message type as its .lcm file has it.
struct TypeText {
  std::string name, text;
};

/// All message types of this build, by name.
const std::vector<TypeText>& type_texts();

}  // namespace tandem
