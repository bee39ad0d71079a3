#include "policy_runtime/policies/head.h"

#include "policy_runtime/file/config_reader.h"
#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/policies/act.h"
#include "policy_runtime/policies/best_of_n.h"
#include "policy_runtime/policies/encoded.h"
#include "policy_runtime/policies/flow.h"
#include "policy_runtime/policies/gaussian.h"
#include "policy_runtime/policies/grasp.h"
#include "policy_runtime/policies/mlp.h"
#include "policy_runtime/policy_error.h"

namespace tandem::policy {

const std::vector<Camera>& Head::cameras() const noexcept {
  static const std::vector<Camera> kNone;
  return kNone;
}

std::unique_ptr<const Head> load_head(SafetensorsFile& file, const std::string& architecture,
                                      ConfigReader config, const HeadSpec& spec) {
  if (architecture == "mlp") return std::make_unique<MlpHead>(file, std::move(config), spec);
  if (architecture == "gaussian")
    return std::make_unique<GaussianHead>(file, std::move(config), spec);
  if (architecture == "flow") return std::make_unique<FlowHead>(file, std::move(config), spec);
  if (architecture == "act") return std::make_unique<ActHead>(file, std::move(config), spec);
  if (architecture == "best_of_n")
    return std::make_unique<BestOfNHead>(file, std::move(config), spec);
  if (architecture == "grasp") return std::make_unique<GraspHead>(file, std::move(config), spec);
  if (architecture == "encoded")
    return std::make_unique<EncodedHead>(file, std::move(config), spec);
  throw PolicyError(file.path() + ": architecture is " + printable(architecture) +
                    "; this runtime knows mlp, gaussian, flow, act, best_of_n, grasp and encoded. "
                    "Train with a method that writes one of these.");
}

}  // namespace tandem::policy
