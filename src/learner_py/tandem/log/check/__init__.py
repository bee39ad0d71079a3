"""Asks a log whether all in it is as it must be: `./tandem log check`.

Errors are what no healthy run shows; notes are worth knowing and do not fail. Everything is compared with what the log
itself tells of its run (SCENARIO); what is not told is not asked.
"""

from __future__ import annotations

import numpy as np

from tandem.log.check import learning, motion
from tandem.log.check.findings import KEPT, KINDS, NOTES, Finding, Report
from tandem.log.check.run import run_of
from tandem.log.event_log import EventLog
from tandem.log.files import missing
from tandem.wire import CHANNELS

__all__ = ["KEPT", "KINDS", "NOTES", "Finding", "Report", "check"]


def check(log: EventLog) -> Report:
    report = Report()
    run = run_of(log)
    _file(log, report)
    learning.episodes(run, report)
    steps = learning.steps(run, report)
    learning.actions(run, steps, report)
    learning.returns(run, steps, report)
    motion.world(run, report)
    motion.states(run, report)
    motion.ticks(run, report)
    motion.status(log, report)
    learning.policies(log, steps, report)
    return report


def _file(log: EventLog, report: Report) -> None:
    index = log.index
    for name in missing(log.path):
        report.add("damage", f"{name} is missing, and others go on after it.")
    for begin, end in index.damage:
        row = int(np.searchsorted(index.offset, begin))
        place = int(log.episodes.of(np.array([row]))[0])
        episode = log.episodes.number[place] if place < len(log.episodes) else None
        report.add("damage", f"{end - begin} bytes at byte {begin} of the log are no events.", episode)
    if index.cut_off_bytes:
        report.add(
            "cut_off", f"the last {index.cut_off_bytes} bytes are an event that its writer did not finish."
        )
    for name in index.channels:
        if name in CHANNELS and (n := len(index.rows(name)) - len(index.rows(name, readable=True))):
            report.add(
                "undecodable",
                f"{n} of {len(index.rows(name))} messages on {name} are not of today's type; the log's SCENARIO and"
                " PROVENANCE name the program that wrote it.",
                count=n,
            )
    if not log.starts:
        report.add("scenario", "the log holds no SCENARIO; it was not recorded by tandem_controller, or cut.")
    elif index.channels[index.channel[0]] != "SCENARIO":
        report.add(
            "scenario",
            f"the log begins with {index.channels[index.channel[0]]}; replay wants SCENARIO first.",
        )
