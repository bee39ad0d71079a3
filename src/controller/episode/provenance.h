#pragma once

#include <string>
#include <tandem/provenance_t.hpp>

namespace tandem {

/// What the log says of its writer: program, libraries, seed, and the texts of all message types.
///
/// @param scenario_text the scenario file that the controller was started with, whole.
/// @param continues_with 0, or the episode that it continues an earlier run with.
provenance_t provenance(const std::string& program_revision, const std::string& scenario_text,
                        int64_t run_seed, int64_t continues_with);

}  // namespace tandem
