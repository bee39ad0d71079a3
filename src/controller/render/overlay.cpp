#include "controller/render/overlay.h"

#include <algorithm>
#include <cstdio>
#include <opencv2/imgproc.hpp>
#include <string>
#include <tandem/episode_end_t.hpp>
#include <tandem/world_state_t.hpp>

namespace tandem {
namespace {

const cv::Scalar kWhite(255, 255, 255), kInk(60, 50, 40), kAuto(150, 120, 20), kHuman(20, 110, 235),
    kGood(70, 150, 40), kBad(50, 50, 200);

const char* outcome_text(int outcome) {
  switch (outcome) {
    case episode_end_t::SUCCESS:
      return "SUCCESS";
    case episode_end_t::TIMEOUT:
      return "TIME OUT";
    case episode_end_t::FAULT:
      return "FAULT";
    case episode_end_t::DISCARD:
      return "DISCARDED";
    default:
      return "FAILURE";
  }
}

const char* phase_text(int phase) {
  switch (phase) {
    case world_state_t::DEMONSTRATION:
      return "demonstration";
    case world_state_t::TRAINING:
      return "training";
    default:
      return "evaluation";
  }
}

// A filled label at `corner` (upper left). @returns its width.
int label(cv::Mat& picture, cv::Point corner, const std::string& text, const cv::Scalar& fill,
          double scale) {
  int baseline = 0;
  const cv::Size size = cv::getTextSize(text, cv::FONT_HERSHEY_DUPLEX, scale, 1, &baseline);
  const int pad = static_cast<int>(14 * scale);
  const cv::Rect box(corner, cv::Size(size.width + 2 * pad, size.height + 2 * pad));
  cv::rectangle(picture, box, fill, cv::FILLED, cv::LINE_AA);
  cv::putText(picture, text, corner + cv::Point(pad, pad + size.height), cv::FONT_HERSHEY_DUPLEX,
              scale, kWhite, 1, cv::LINE_AA);
  return box.width;
}

}  // namespace

void draw_overlay(cv::Mat& picture, const RecordedEpisode& episode, const Moment& moment,
                  bool finished) {
  const double scale = picture.rows / 900.0;
  const int margin = static_cast<int>(16 * scale), gap = margin / 2,
            line = static_cast<int>(60 * scale);
  char text[100];
  std::snprintf(
      text, sizeof text, "%s  episode %lld  step %d/%d", phase_text(episode.phase),
      static_cast<long long>(episode.number),
      finished ? episode.n_steps
               : std::min(episode.step_at(static_cast<double>(moment.tick)) + 1, episode.n_steps),
      episode.max_steps);
  cv::Point corner(margin, margin);
  label(picture, corner, text, kInk, scale);
  corner.y += line;
  corner.x += label(picture, corner, moment.alpha > 0.5 ? "HUMAN" : "AUTO",
                    moment.alpha > 0.5 ? kHuman : kAuto, scale) +
              gap;
  std::snprintf(text, sizeof text, "force %4.1f N", moment.force.norm());
  corner.x += label(picture, corner, text, kInk, scale) + gap;
  if (finished)
    label(picture, corner, outcome_text(episode.outcome),
          episode.outcome == episode_end_t::SUCCESS ? kGood : kBad, scale);
}

}  // namespace tandem
