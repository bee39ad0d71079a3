"""Speed of gym_hil's PandaPickCube without images: `python -m tandem.cli.gym_hil_speed SECONDS OUT.json`.

A program of its own, so that its MuJoCo and ours never share a process.
"""

import json
import os
import sys
import time
from pathlib import Path


def main() -> None:
    seconds, out = float(sys.argv[1]), Path(sys.argv[2])
    # It makes a renderer even when it never draws; EGL needs no screen.
    os.environ.setdefault("MUJOCO_GL", "egl")
    os.environ.setdefault("EGL_PLATFORM", "surfaceless")
    from gym_hil.envs import PandaPickCubeGymEnv

    env = PandaPickCubeGymEnv(image_obs=False)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(1000)]
    episode_steps = 100  # as its registration says

    def run(limit_s: float) -> tuple[int, float]:
        steps, start = 0, time.perf_counter()
        while (elapsed := time.perf_counter() - start) < limit_s:
            if steps % episode_steps == 0:
                env.reset(seed=steps)
            _, _, terminated, truncated, _ = env.step(actions[steps % len(actions)])
            if terminated or truncated:
                env.reset()
            steps += 1
        return steps, elapsed

    run(0.5)
    steps, elapsed = run(seconds)
    out.write_text(json.dumps({"env_steps": steps, "wall_s": elapsed, "env_steps_per_s": steps / elapsed}))


if __name__ == "__main__":
    main()
