#include "controller/camera/camera_worker.h"

#include <cstdio>
#include <cstdlib>

#include "controller/camera/camera_view.h"

namespace tandem {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kFirstFrame{1000};  // real time: so long for the first of an episode
constexpr milliseconds kDeadline{10'000};  // lockstep: longer than any frame takes

}  // namespace

CameraWorker::CameraWorker(const Simulation& simulation, const CameraSettings& settings,
                           bool lockstep, Sink sink, StatusBoard& board)
    : simulation_(simulation), lockstep_(lockstep), sink_(std::move(sink)), board_(board) {
  // Mesa's software renderer on this thread alone: at so few pixels its helpers only cost, and they
  // would take the other cores from the control thread and the learner.
  setenv("LP_NUM_THREADS", "0", 0);
  thread_ = std::thread([this, settings] { run(settings); });
  while (!started_.wait_for(kDeadline)) {
  }
  if (failure_) {
    thread_.join();
    std::rethrow_exception(failure_);
  }
}

CameraWorker::~CameraWorker() {
  stopping_ = true;
  asked_.post();
  thread_.join();
}

bool CameraWorker::ask(const StepSnapshot& snapshot) noexcept {
  SceneState* state = states_.claim();
  if (!state) return false;
  state->utime = snapshot.utime;
  state->episode = snapshot.episode;
  state->tick = snapshot.tick;
  state->step = snapshot.step;
  state->episode_seed = snapshot.episode_seed;
  CameraView::capture(simulation_, *state);
  states_.publish();
  asked_.post();
  return true;
}

void CameraWorker::run(const CameraSettings& settings) {
  std::unique_ptr<CameraView> view;
  try {
    view = std::make_unique<CameraView>(simulation_, settings);
    auto first = std::make_unique<SceneState>();
    CameraView::capture(simulation_, *first);
    view->frame(*first);
  } catch (const std::exception&) {
    failure_ = std::current_exception();
    started_.post();
    return;
  }
  started_.post();
  while (!stopping_) {
    asked_.wait_for(milliseconds(100));
    while (SceneState* state = states_.front()) {
      // Real time: what is past is not worth drawing.
      if (lockstep_ || states_.size() == 1) {
        const int64_t start_ns = monotonic_ns();
        std::shared_ptr<const CameraFrame> frame = view->frame(*state);
        board_.camera_time.add_ns(monotonic_ns() - start_ns);
        ++board_.camera_frames;
        sink_(frame);
        frames_.push(frame);
        drawn_.post();
      }
      states_.pop();
    }
  }
}

void CameraWorker::take_new(const StepSnapshot& snapshot) noexcept {
  if (newest_ && newest_->episode != snapshot.episode) newest_.reset();
  while (std::shared_ptr<const CameraFrame>* frame = frames_.front()) {
    if ((*frame)->episode == snapshot.episode) newest_ = *frame;
    frame->reset();
    frames_.pop();
  }
}

std::shared_ptr<const CameraFrame> CameraWorker::frame(const StepSnapshot& snapshot) noexcept {
  const int64_t start_us = monotonic_us();
  for (;;) {
    take_new(snapshot);
    if (newest_ && newest_->step == snapshot.step) return newest_;
    const milliseconds patience = lockstep_ ? kDeadline : newest_ ? kPatience : kFirstFrame;
    const int64_t left_us = std::chrono::microseconds(patience).count() + start_us - monotonic_us();
    if (left_us <= 0 || stopping_) break;
    drawn_.wait_for(std::chrono::microseconds(left_us));
  }
  ++board_.camera_late;
  return newest_;
}

}  // namespace tandem
