"""`python -m tandem.learner --scenario RUN/scenario.yaml --run RUN [--lcm-url URL]`

Exit codes: 0 finished, 1 the controller fell silent, 2 bad scenario or input (one sentence on stderr), 3 the controller
refused a policy or its data contradict the scenario, 130 stopped by SIGINT or SIGTERM after saving.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tandem.learner.xla import configure


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tandem.learner", description="Learns from executed episodes."
    )
    parser.add_argument("--scenario", type=Path, required=True, help="resolved scenario, RUN/scenario.yaml")
    parser.add_argument(
        "--run",
        type=Path,
        required=True,
        help="run folder, holds log.lcm; receives policies/ and checkpoints/",
    )
    parser.add_argument(
        "--lcm-url", default=None, help="default: LCM_DEFAULT_URL, else LCM's own group with ttl 0"
    )
    arguments = parser.parse_args()

    configure()
    # JAX is imported below here, after its settings are made
    from tandem.learner.config import load_scenario
    from tandem.learner.process import LearnerProcess
    from tandem.scenario import ScenarioError

    try:
        scenario = load_scenario(arguments.scenario)
        process = LearnerProcess(scenario, arguments.run, arguments.lcm_url)
    except (ScenarioError, RuntimeError) as error:
        print(error, file=sys.stderr, flush=True)
        return 2
    process.stop_on_signals()
    return process.run()


if __name__ == "__main__":
    sys.exit(main())
