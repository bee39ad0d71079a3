"""Demonstrations that come from elsewhere: the log of another run, or an imported dataset, as the beginning of a log.

A run whose log begins with them goes on after them like one that was stopped there: the controller counts them, the
learner reads them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path

import lcm
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.scenario_t import scenario_t

from tandem.learner.episode import Episode
from tandem.learner.windows import with_discount
from tandem.log import episodes
from tandem.log.files import refuse_leftovers
from tandem.run_folder import RunFolderError, git_revision, shown
from tandem.scenario import Scenario

SLOT_US = 1_000_000  # of log time; nothing reads more from it than the order


def successful(log: Path) -> list[Episode]:
    """The successful demonstrations of a log, numbered anew from 0. Raises RunFolderError when there is none."""
    found = [episode for episode in episodes(log) if episode.is_demonstration and episode.is_learnable]
    if not found:
        raise RunFolderError(f"{shown(log)} holds no successful demonstration; give a log that does.")
    return [dataclasses.replace(episode, number=number) for number, episode in enumerate(found)]


def count(log: Path) -> int:
    return len(successful(log))


def begin(log: Path, scenario: Scenario, source: Path) -> None:
    """Writes a new log that begins with the demonstrations of another one, as many as the scenario asks for."""
    given = successful(source)[: scenario.run["demonstrations"]]
    task = scenario.data["task"]
    width, wanted = given[0].observation.shape[1] if given else 0, len(scenario.observation)
    if given and width != wanted:
        raise RunFolderError(
            f"{shown(source)} has observations of {width} numbers, and {task['name']} of {wanted};"
            " give demonstrations of the same task with the same run.observe."
        )
    discount = scenario.data["method"]["discount"]
    write_log(log, scenario, (with_discount(episode, discount) for episode in given))


def write_log(log: Path, scenario: Scenario, given: Iterable[Episode]) -> None:
    """A standard event log, whole or not at all: SCENARIO, then each episode's steps and its end."""
    log.parent.mkdir(parents=True, exist_ok=True)
    refuse_leftovers(log)
    partial = log.with_name(log.name + ".part")
    file = lcm.EventLog(str(partial), "w", overwrite=True)
    try:
        file.write_event(0, "SCENARIO", _scenario_message(scenario).encode())
        for episode in given:
            steps, end = episode.to_messages()
            time = SLOT_US * (episode.number + 1)
            end.utime = time
            for step in steps:
                file.write_event(time, "EPISODE_STEP", step.encode())
            file.write_event(time, "EPISODE_END", end.encode())
    finally:
        file.close()
    partial.replace(log)


def _scenario_message(scenario: Scenario) -> scenario_t:
    message = scenario_t()
    message.scenario_yaml = scenario.dumps()
    message.git_revision = git_revision()
    message.observation_names = ",".join(scenario.observation)
    return message


def end_of_demonstration(number: int, n_steps: int, episode_seed: int = 0) -> episode_end_t:
    """EPISODE_END of a successful demonstration that a person drove alone."""
    end = episode_end_t()
    end.episode, end.episode_seed, end.n_steps = number, episode_seed, n_steps
    end.n_intervention_steps, end.n_takeovers, end.undiscounted_return = n_steps, 1, 1.0
    return end  # phase DEMONSTRATION and outcome SUCCESS are 0
