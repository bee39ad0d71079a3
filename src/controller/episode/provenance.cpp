#include "controller/episode/provenance.h"

#include <mujoco/mujoco.h>

#include <Eigen/Core>

#include "base/sha256.h"
#include "lcm_types/type_texts.h"

namespace tandem {

provenance_t provenance(const std::string& program_revision, const std::string& scenario_text,
                        int64_t run_seed, int64_t continues_with) {
  provenance_t m;
  m.utime = 0;
  m.continues_with = continues_with;
  m.run_seed = run_seed;
  m.program_revision = program_revision;
  Sha256 digest;
  digest.add(scenario_text.data(), scenario_text.size());
  m.scenario_sha256 = digest.hex();
  const auto dotted = [](int a, int b, int c) {
    return std::to_string(a) + "." + std::to_string(b) + "." + std::to_string(c);
  };
  m.library_names = {"compiler", "eigen", "lcm", "mujoco"};
  m.library_versions = {__VERSION__,
                        dotted(EIGEN_WORLD_VERSION, EIGEN_MAJOR_VERSION, EIGEN_MINOR_VERSION),
                        TANDEM_LCM_VERSION, mj_versionString()};
  m.n_versions = static_cast<int32_t>(m.library_names.size());
  for (const TypeText& type : type_texts()) {
    m.type_names.push_back(type.name);
    m.type_texts.push_back(type.text);
  }
  m.n_types = static_cast<int32_t>(m.type_names.size());
  return m;
}

}  // namespace tandem
