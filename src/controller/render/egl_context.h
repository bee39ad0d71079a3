#pragma once

namespace tandem {

/// An OpenGL context without a window or a display server, current on the constructing thread while
/// it lives. Mesa renders in software when there is no GPU.
class EglContext {
 public:
  EglContext();  ///< @throws std::runtime_error with a sentence that names the packages when there
                 ///< is no EGL.
  ~EglContext();
  EglContext(const EglContext&) = delete;
  EglContext& operator=(const EglContext&) = delete;

 private:
  void* display_ = nullptr;
  void* context_ = nullptr;
};

}  // namespace tandem
