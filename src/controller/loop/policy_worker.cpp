#include "controller/loop/policy_worker.h"

#include "base/random.h"
#include "controller/loop/clock.h"

namespace tandem {

PolicyWorker::PolicyWorker(const Task& task, policy::PolicySlot& slot, int priority,
                           CameraWorker* camera)
    : task_(task), slot_(slot), camera_(camera) {
  for (int axis = 0, output = 0; axis < 7; ++axis) {
    if (task.spec().axes[axis] != 0.0) axis_of_output_[output++] = axis;
  }
  thread_ = std::thread([this, priority] {
    if (priority > 0) ask_for_priority(priority);
    run();
  });
}

PolicyWorker::~PolicyWorker() {
  stopping_ = true;
  asked_.post();
  thread_.join();
}

bool PolicyWorker::ask(const StepSnapshot& snapshot) noexcept {
  if (camera_ && !camera_->ask(snapshot)) return false;
  const bool taken = questions_.push(snapshot);
  asked_.post();
  return taken;
}

void PolicyWorker::run() noexcept {
  while (!stopping_) {
    asked_.wait_for(std::chrono::milliseconds(100));
    while (StepSnapshot* snapshot = questions_.front()) {
      PolicyAnswer* answer = answers_.claim();
      if (!answer) break;
      answer->observation.step = snapshot->step;
      task_.observation().write(*snapshot, answer->observation.values.data());
      const std::shared_ptr<const CameraFrame> frame =
          camera_ ? camera_->frame(*snapshot) : nullptr;
      answer->observation.image_step = frame ? frame->step : -1;
      answer->has_chunk = false;
      if (snapshot->chunk_id >= 0) infer(*snapshot, frame.get(), *answer);
      questions_.pop();
      answers_.publish();
      answered_.post();
    }
  }
}

void PolicyWorker::infer(const StepSnapshot& snapshot, const CameraFrame* frame,
                         PolicyAnswer& answer) noexcept {
  policy::PolicySlot::Active* active = slot_.acquire();
  if (!active) return;
  const int64_t start_ns = monotonic_ns();
  const uint8_t* const images[1] = {frame ? frame->pixels.data() : nullptr};
  const policy::Input input{.observation = answer.observation.values.data(),
                            .images = frame ? images : nullptr,
                            .seed = random_for(snapshot.episode_seed, Purpose::policy_noise,
                                               static_cast<uint64_t>(snapshot.chunk_id))
                                        .next()};
  if (!active->forward(input, output_.data())) return;

  // Scatter the active axes into the seven of the wire.
  const policy::Header& header = active->policy->header();
  Chunk& chunk = answer.chunk;
  chunk.id = snapshot.chunk_id;
  chunk.observation_tick = snapshot.tick;
  chunk.policy_version = static_cast<int32_t>(header.version);
  chunk.start_step = snapshot.step;
  chunk.horizon = static_cast<int32_t>(header.horizon);
  const int n_axes = static_cast<int>(task_.spec().action_axes.size());
  for (int i = 0; i < chunk.horizon; ++i) {
    chunk.actions[i].setZero();
    for (int output = 0; output < n_axes; ++output) {
      chunk.actions[i][axis_of_output_[output]] = output_[i * n_axes + output];
    }
  }
  chunk.inference_us = static_cast<int32_t>((monotonic_ns() - start_ns) / 1000);
  answer.has_chunk = true;
}

}  // namespace tandem
