# find_package(TandemPolicy): the target TandemPolicy::policy_runtime
include(CMakeFindDependencyMacro)
find_dependency(hwy)
include(${CMAKE_CURRENT_LIST_DIR}/TandemPolicyTargets.cmake)
