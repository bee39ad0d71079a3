#include "policy_runtime/vision_file.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <random>

namespace tandem::policy::testing {
namespace {

using Json = nlohmann::json;

const std::string kPrefix = "actor.backbone.";

class RandomTensors {
 public:
  explicit RandomTensors(unsigned seed) : random_(seed) {
    uniform("actor.image.mean", {3}, 0.4f, 0.5f);
    uniform("actor.image.scale", {3}, 4.0f, 4.6f);
  }

  void uniform(const std::string& name, const std::vector<std::int64_t>& shape, float low,
               float high) {
    std::size_t size = 1;
    for (const auto dimension : shape) size *= dimension;
    std::uniform_real_distribution<float> distribution(low, high);
    Tensor& made = file.tensors[name] = {shape, std::vector<float>(size)};
    for (float& value : made.values) value = distribution(random_);
  }

  // Keeps the size of the signal from layer to layer.
  void weight(const std::string& name, std::int64_t out, std::int64_t in, std::int64_t k) {
    const float bound = std::sqrt(6.0f / float(in * k * k));
    uniform(kPrefix + name + ".weight", {out, in, k, k}, -bound, bound);
  }

  void norm(const std::string& name, std::int64_t out) {
    uniform(kPrefix + name + ".weight", {out}, 0.4f, 0.8f);
    uniform(kPrefix + name + ".bias", {out}, -0.2f, 0.2f);
    uniform(kPrefix + name + ".running_mean", {out}, -0.3f, 0.3f);
    uniform(kPrefix + name + ".running_var", {out}, 0.5f, 2.0f);
  }

  PolicyFile file;

 private:
  std::mt19937 random_;
};

Volume normalised(const PolicyFile& file, const std::vector<std::uint8_t>& image, int height,
                  int width) {
  Volume x{height, width, 3, std::vector<double>(image.begin(), image.end())};
  for (std::size_t i = 0; i < x.values.size(); ++i) {
    const double mean = file.tensors.at("actor.image.mean").values[i % 3];
    x.values[i] = (x.values[i] / 255 - mean) * file.tensors.at("actor.image.scale").values[i % 3];
  }
  return x;
}

template <typename F>
Volume for_each(Volume x, F f) {
  for (std::size_t i = 0; i < x.values.size(); ++i) x.values[i] = f(x.values[i], i);
  return x;
}

Volume relu(Volume x) {
  return for_each(std::move(x), [](double v, std::size_t) { return v > 0 ? v : 0; });
}

Volume convolve_norm(const PolicyFile& file, const Volume& x, const std::string& name,
                     const std::string& norm, int stride) {
  const auto values = [&](const std::string& part) -> const std::vector<float>& {
    return file.tensors.at(kPrefix + norm + part).values;
  };
  Volume y = convolve(x, file.tensors.at(kPrefix + name + ".weight"), stride);
  return for_each(std::move(y), [&](double v, std::size_t i) {
    const std::size_t c = i % values(".weight").size();
    return (v - values(".running_mean")[c]) / std::sqrt(values(".running_var")[c] + 1e-5) *
               values(".weight")[c] +
           values(".bias")[c];
  });
}

Volume max_pool(const Volume& in) {
  Volume out{(in.height + 1) / 2, (in.width + 1) / 2, in.channels, {}};
  for (int y = 0; y < out.height; ++y) {
    for (int x = 0; x < out.width; ++x) {
      for (int c = 0; c < in.channels; ++c) {
        double largest = -INFINITY;
        for (int v = std::max(0, 2 * y - 1); v <= std::min(in.height - 1, 2 * y + 1); ++v) {
          for (int u = std::max(0, 2 * x - 1); u <= std::min(in.width - 1, 2 * x + 1); ++u) {
            largest = std::max(largest, in.at(v, u, c));
          }
        }
        out.values.push_back(largest);
      }
    }
  }
  return out;
}

}  // namespace

PolicyFile make_resnet18(int width, unsigned seed) {
  RandomTensors made(seed);
  made.weight("conv1", width, 3, 7);
  made.norm("bn1", width);
  int in = width;
  for (int stage = 0; stage < 4; ++stage) {
    const int out = width << stage;
    for (int block = 0; block < 2; ++block) {
      const std::string name =
          "layer" + std::to_string(stage + 1) + "." + std::to_string(block) + ".";
      made.weight(name + "conv1", out, in, 3);
      made.norm(name + "bn1", out);
      made.weight(name + "conv2", out, out, 3);
      made.norm(name + "bn2", out);
      if (in != out) {
        made.weight(name + "downsample.0", out, in, 1);
        made.norm(name + "downsample.1", out);
      }
      in = out;
    }
  }
  return made.file;
}

PolicyFile make_cnn(const std::vector<CnnLayer>& layers, unsigned seed) {
  RandomTensors made(seed);
  int in = 3;
  for (std::size_t i = 0; i < layers.size(); ++i) {
    const std::string name = std::to_string(i);
    made.weight(name, layers[i].channels, in, layers[i].kernel);
    made.uniform(kPrefix + name + ".bias", {layers[i].channels}, -0.3f, 0.3f);
    in = layers[i].channels;
  }
  return made.file;
}

std::string resnet18_config(int width) {
  return Json{{"kind", "resnet18"}, {"width", width}}.dump();
}

std::string cnn_config(const std::vector<CnnLayer>& layers) {
  Json list = Json::array();
  for (const CnnLayer& layer : layers) {
    list.push_back(
        {{"channels", layer.channels}, {"kernel", layer.kernel}, {"stride", layer.stride}});
  }
  return Json{{"kind", "cnn"}, {"layers", list}}.dump();
}

std::vector<std::uint8_t> random_image(int height, int width, unsigned seed) {
  std::mt19937 random(seed);
  std::vector<std::uint8_t> image(std::size_t(height) * width * 3);
  for (std::uint8_t& byte : image) byte = static_cast<std::uint8_t>(random());
  return image;
}

Volume convolve(const Volume& in, const Tensor& weight, int stride) {
  const int k = int(weight.shape[2]), out_channels = int(weight.shape[0]);
  Volume out{(in.height - 1) / stride + 1, (in.width - 1) / stride + 1, out_channels, {}};
  for (int y = 0; y < out.height; ++y) {
    for (int x = 0; x < out.width; ++x) {
      const float* w = weight.values.data();
      for (int o = 0; o < out_channels; ++o) {
        double sum = 0;
        for (int c = 0; c < in.channels; ++c) {
          for (int i = 0; i < k * k; ++i, ++w) {
            const int v = y * stride + i / k - k / 2, u = x * stride + i % k - k / 2;
            if (v >= 0 && v < in.height && u >= 0 && u < in.width) sum += *w * in.at(v, u, c);
          }
        }
        out.values.push_back(sum);
      }
    }
  }
  return out;
}

Volume evaluate_resnet18(const PolicyFile& file, const std::vector<std::uint8_t>& image, int height,
                         int width) {
  Volume x = normalised(file, image, height, width);
  x = max_pool(relu(convolve_norm(file, x, "conv1", "bn1", 2)));
  for (int stage = 1; stage <= 4; ++stage) {
    for (int block = 0; block < 2; ++block) {
      const std::string name = "layer" + std::to_string(stage) + "." + std::to_string(block) + ".";
      const int stride = stage > 1 && block == 0 ? 2 : 1;
      Volume y = relu(convolve_norm(file, x, name + "conv1", name + "bn1", stride));
      y = convolve_norm(file, y, name + "conv2", name + "bn2", 1);
      if (stride == 2) {
        x = convolve_norm(file, x, name + "downsample.0", name + "downsample.1", 2);
      }
      x = relu(for_each(std::move(y), [&](double v, std::size_t i) { return v + x.values[i]; }));
    }
  }
  return x;
}

Volume evaluate_cnn(const PolicyFile& file, const std::vector<CnnLayer>& layers,
                    const std::vector<std::uint8_t>& image, int height, int width) {
  Volume x = normalised(file, image, height, width);
  for (std::size_t i = 0; i < layers.size(); ++i) {
    const std::string name = kPrefix + std::to_string(i);
    const auto& bias = file.tensors.at(name + ".bias").values;
    x = convolve(x, file.tensors.at(name + ".weight"), layers[i].stride);
    x = relu(
        for_each(std::move(x), [&](double v, std::size_t j) { return v + bias[j % bias.size()]; }));
  }
  return x;
}

}  // namespace tandem::policy::testing
