#pragma once

#include <mujoco/mujoco.h>

#include <cstdint>

namespace tandem {

/// Draws colour and brightness of an episode's LED lights: the lights of the scene whose names
/// begin with `led_`, each on its own. Only looks; a scene without such lights stays as it is.
///
/// The scene's numeric `leds` says within which limits: lowest brightness, highest brightness
/// (diffuse, 1 = full), highest saturation. The same seed gives the same lights in any copy of the
/// model, so that whoever draws pictures calls this when an episode begins.
void light_leds(mjModel* model, uint64_t episode_seed) noexcept;

}  // namespace tandem
