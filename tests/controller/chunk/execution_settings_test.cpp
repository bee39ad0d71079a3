#include "controller/chunk/execution_settings.h"

#include <gtest/gtest.h>

#include <fstream>

#include "controller/chunk/reference_filter.h"

namespace tandem {
namespace {

Section load(const std::string& yaml) {
  const std::string path =
      ::testing::TempDir() + "execution_settings_test_" + std::to_string(getpid()) + ".yaml";
  std::ofstream(path) << yaml;
  return Section::load(path);
}

std::string execution(const std::string& mode, int execute, int latency) {
  return "mode: " + mode + "\nexecute: " + std::to_string(execute) +
         "\nensemble_decay: 0.01\nlatency_ticks: " + std::to_string(latency) +
         "\nnoise_chunk: 0.1\nnoise_step: 0.2\nnoise_clip: 0.3\nnoise_speed: 0.5\n";
}

template <typename Function>
std::string refusal(Function function) {
  try {
    function();
  } catch (const ScenarioError& error) {
    return error.what();
  }
  return "accepted";
}

TEST(ExecutionSettings, WhatAllMethodsShareIsValid) {
  Section method = Section::load(std::string(TANDEM_ROOT) + "/config/method.yaml");
  const auto horizon = static_cast<int>(method.integer("horizon", 1, 32));
  const ExecutionSettings settings = read_execution(method.section("execution"), horizon, 100);
  EXPECT_EQ(settings.horizon, horizon);
  EXPECT_EQ(settings.latency_ticks, 0);
}

TEST(ExecutionSettings, ReadsEveryMode) {
  EXPECT_EQ(read_execution(load(execution("receding", 1, 0)), 4, 100).mode,
            ExecutionMode::receding);
  EXPECT_EQ(read_execution(load(execution("open_loop", 4, 0)), 4, 100).execute, 4);
  const ExecutionSettings settings =
      read_execution(load(execution("temporal_ensembling", 1, 99)), 4, 100);
  EXPECT_EQ(settings.mode, ExecutionMode::temporal_ensembling);
  EXPECT_EQ(settings.ensemble_decay, 0.01);
  EXPECT_EQ(settings.latency_ticks, 99);
}

TEST(ExecutionSettings, RefusesWhatCannotBeExecutedWithItsLimit) {
  const auto said = [](const std::string& yaml) {
    return refusal([&] { read_execution(load(yaml), 4, 100); });
  };
  EXPECT_NE(said(execution("open_loop", 5, 0)).find("execute is 5; it must be in [1, 4]"),
            std::string::npos);
  EXPECT_NE(said(execution("receding", 1, 100)).find("latency_ticks is 100; it must be in [0, 99]"),
            std::string::npos);
  EXPECT_NE(said(execution("ensemble", 1, 0)).find("temporal_ensembling"), std::string::npos);
  EXPECT_NE(said(execution("receding", 1, 0) + "decay: 1\n").find("decay"), std::string::npos);
}

TEST(ReferenceSettings, TheDefaultIsValidAndKeepsATickWithinHalfAMillimetre) {
  Section controller = Section::load(std::string(TANDEM_ROOT) + "/config/controller.yaml");
  const ReferenceSettings settings = read_reference(controller.section("reference"));
  EXPECT_LE(settings.velocity_linear, 0.5);
  EXPECT_LE(settings.velocity_angular, 5.0);
}

TEST(ReferenceSettings, AnAccelerationThatCannotBrakeInTimeIsRefused) {
  const std::string said = refusal([] {
    read_reference(
        load("omega_rad_s: 80\nvelocity_limit_m_s: 0.5\nvelocity_limit_rad_s: 1.5\n"
             "acceleration_limit_m_s2: 10\nacceleration_limit_rad_s2: 100\n"));
  });
  EXPECT_NE(said.find("acceleration_limit_m_s2 is 10"), std::string::npos) << said;
  EXPECT_NE(said.find("at least 14.7"), std::string::npos) << said;
}

}  // namespace
}  // namespace tandem
