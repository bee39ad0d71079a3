#include "controller/robot/leds.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/random.h"

namespace tandem {
namespace {

// One channel of a colour of full value; phases of red, green and blue lie a third of a turn apart.
double channel(double hue, double phase, double saturation) {
  const double turn = hue + phase - std::floor(hue + phase);
  const double pure = std::clamp(std::abs(6.0 * turn - 3.0) - 1.0, 0.0, 1.0);
  return 1.0 - saturation * (1.0 - pure);
}

}  // namespace

void light_leds(mjModel* model, uint64_t episode_seed) noexcept {
  const int numeric = mj_name2id(model, mjOBJ_NUMERIC, "leds");
  if (numeric < 0 || model->numeric_size[numeric] != 3) return;
  const mjtNum* limit = model->numeric_data + model->numeric_adr[numeric];
  for (int light = 0; light < model->nlight; ++light) {
    const char* name = mj_id2name(model, mjOBJ_LIGHT, light);
    if (!name || std::strncmp(name, "led_", 4) != 0) continue;
    Random random = random_for(episode_seed, Purpose::light, static_cast<uint64_t>(light));
    const double brightness = random.uniform(limit[0], limit[1]);
    const double hue = random.uniform(0.0, 1.0), saturation = random.uniform(0.0, limit[2]);
    for (int i = 0; i < 3; ++i) {
      model->light_diffuse[3 * light + i] =
          static_cast<float>(brightness * channel(hue, (3 - i) % 3 / 3.0, saturation));
    }
  }
}

}  // namespace tandem
