"""Our update as a contender: `python -m tandem.learner_bench.ours SCENARIO WORK`.

Orders on stdin, one a line, each answered by a line of JSON:

    run N    N updates -> [microseconds of one]
    losses 0 -> [the critic's, of all members together; the actor's] on the minibatch of the work file
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from tandem.learner import xla

xla.configure()

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from tandem.learner.config import load_scenario  # noqa: E402
from tandem.learner.critic import regression_loss  # noqa: E402
from tandem.learner.normalizer import Normalizer  # noqa: E402
from tandem.learner.trainer import Trainer  # noqa: E402
from tandem.learner.windows import Windows  # noqa: E402
from tandem.learner_bench import work  # noqa: E402


def main(scenario: Path, work_file: Path) -> None:
    trainer = Trainer(load_scenario(scenario))
    given = np.load(work_file)
    observation, chunk = given["rows.observation"], given["rows.chunk"]
    n, horizon = chunk.shape[:2]
    yes = np.ones((n, horizon), bool)
    earned = given["rows.mc_return"]
    windows = Windows(observation, chunk, yes, yes, earned, observation, earned, np.zeros(n, np.float32))
    trainer.buffer.add(windows, dict.fromkeys(trainer.method.row_sets, yes[:, 0]))
    trainer.normalizer = Normalizer.identity(observation.shape[1])
    trainer.compile()
    trainer.relearn(64)

    def losses() -> list[float]:
        method, rows = trainer.method, slice(0, len(given["time"]))
        state = method.init(trainer.scenario.run.seed)
        x, target = jnp.asarray(observation[rows]), jnp.asarray(chunk[rows])
        critic = regression_loss(method.values(state.critics["critic"], x, target), earned[rows])
        weight = jnp.ones(target.shape[:2])
        actor = method.actor.imitation_loss(state.actors["actor"], x, target, weight, work.noise_key())
        return [float(critic), float(actor)]

    print(json.dumps({}), flush=True)
    for line in sys.stdin:
        order, count = line.split()
        if order == "losses":
            answer = losses()
        else:
            began = time.perf_counter()
            trainer.relearn(int(count))
            answer = [(time.perf_counter() - began) / int(count) * 1e6]
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
