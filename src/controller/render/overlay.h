#pragma once

#include <opencv2/core.hpp>

#include "controller/render/recording.h"

namespace tandem {

/// Writes onto a picture: which episode and step, who drives (AUTO or HUMAN, by alpha), the force
/// and, when `finished`, the outcome.
void draw_overlay(cv::Mat& picture, const RecordedEpisode& episode, const Moment& moment,
                  bool finished);

}  // namespace tandem
