#include "controller/render/video.h"

#include <stdexcept>

namespace tandem {

Video::Video(const std::string& path, int width, int height, double fps) {
  for (const char* codec : {"avc1", "mp4v"}) {
    codec_ = codec;
    const int fourcc = cv::VideoWriter::fourcc(codec[0], codec[1], codec[2], codec[3]);
    if (writer_.open(path, cv::CAP_FFMPEG, fourcc, fps, cv::Size(width, height))) return;
  }
  throw std::runtime_error(
      path + ": the video cannot be written; is the folder there and does the name end in .mp4?");
}

}  // namespace tandem
