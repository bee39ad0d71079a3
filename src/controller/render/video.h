#pragma once

#include <opencv2/videoio.hpp>
#include <string>

namespace tandem {

/// An MP4 file: H.264 where OpenCV can write it, else MPEG-4.
class Video {
 public:
  /// @throws std::runtime_error with a sentence if the file cannot be written.
  Video(const std::string& path, int width, int height, double fps);

  void write(const cv::Mat& picture) { writer_.write(picture); }  ///< BGR, of the size given above
  void close() { writer_.release(); }
  const char* codec() const { return codec_; }

 private:
  cv::VideoWriter writer_;
  const char* codec_ = "";
};

}  // namespace tandem
