"""`tandem log check`."""

from typing import Annotated

import typer

from tandem.cli.common import JsonOption, fail, sentences, write_json
from tandem.cli.log.common import LogArgument, opened


def check(
    log: LogArgument,
    ignore: Annotated[
        list[str] | None,
        typer.Option(metavar="KIND", help="Do not fail because of this kind of finding; repeatable."),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Ask a log whether all in it is as it must be; exit code 1 when not.

    Damage, gaps by ticks and numbers, overruns, torque limits and rates, workspace, actions against what policy and
    human asked, interventions against the operator's commands, returns computed again from the rewards, digests of
    episodes and policy files. Notes (faults, forces above the static bound, a cut-off tail) do not fail.
    """
    from tandem.log.check import KEPT, KINDS, NOTES
    from tandem.log.check import check as ask

    ignored = set(ignore or ())
    if unknown := ignored - set(KINDS):
        fail(f"--ignore is {sorted(unknown)[0]}; the kinds are {', '.join(KINDS)}.", 2)
    with sentences():
        event_log = opened(log)
        report = ask(event_log)
    for finding in report.findings:
        mark = "ignored" if finding.kind in ignored else "error" if finding.is_error else "note"
        print(f"{mark:<7} {finding}")
    for kind, n in report.counts.items():
        if (told := sum(finding.kind == kind for finding in report.findings)) == KEPT and n > told:
            print(f"        {kind}: and {n - told} more.")
    errors = sum(n for kind, n in report.counts.items() if kind not in NOTES | ignored)
    verdict = f"{errors} errors" if errors else "no error"
    print(f"{event_log.path}: {len(event_log.index)} events, {len(event_log.episodes)} episodes, {verdict}.")
    write_json(json_file, {"file": str(event_log.path), "ignored": sorted(ignored), **report.as_json()})
    if errors:
        raise typer.Exit(1)
