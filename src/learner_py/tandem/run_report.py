"""RUN/report.html: all of a run on one page that needs nothing but a browser.

Style and charts (SVG) lie in the page; its content security policy forbids the browser to fetch anything, so that it
stays so. It can be written at any moment of a run: what is not there yet is said.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from tandem_lcm.tandem.episode_end_t import episode_end_t

from tandem import plot, run_folder, scenario, summary
from tandem.log.files import files_of
from tandem.run_charts import charts
from tandem.run_facts import Facts, read
from tandem.run_folder import RunFolder, shown
from tandem.scenario import Scenario, ScenarioError
from tandem.statistics import mean, percent
from tandem.words import OUTCOMES

TEMPLATE = "run_report.html"  # beside this file


def write(folder: RunFolder) -> Path:
    """Writes the page whole or not at all. @raises ScenarioError, RunFolderError or OSError with a sentence."""
    page = render(read(folder))
    partial = folder.report.with_name(folder.report.name + ".part")
    partial.write_text(page, encoding="utf-8")
    partial.replace(folder.report)
    return folder.report


def render(facts: Facts) -> str:
    """The page."""
    import jinja2
    from markupsafe import Markup

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    run = facts.scenario.run
    return environment.get_template(TEMPLATE).render(
        title=f"{run['task']} · {run['method']} · seed {run['seed']}",
        state=_state(facts),
        finished=facts.summary is not None,
        headline=_headline(facts),
        figures=_figures(facts),
        evaluations=[_evaluation(value) for value in facts.evaluations],
        charts=[(name, about, Markup(svg)) for name, about, svg in charts(facts)],
        differences=differences(facts.scenario),
        commands=_commands(facts.folder),
        files=_files(facts.folder),
        written=time.strftime("%Y-%m-%d %H:%M:%S"),
        revision=(facts.summary or {}).get("git_revision") or run_folder.git_revision(),
        host=(facts.summary or {}).get("host") or run_folder.host(),
    )


def _state(facts: Facts) -> str:
    if facts.summary is not None:
        return "finished"
    steps = max((end.env_steps_total for end in facts.episodes), default=0)
    return f"not finished: {steps} of {facts.scenario.run['env_steps']} env steps so far"


def _headline(facts: Facts) -> list[tuple[str, str, str]]:
    """Label, figure, remark: what one looks for first."""
    recent = facts.episodes[-plot.WINDOW :]
    shown: list[tuple[str, str, str]] = []
    if facts.summary is not None:
        last = facts.summary["fresh"]["last"]
        shown.append(
            ("success on fresh seeds", percent(last["successes"], last["episodes"]), "last checkpoint")
        )
        human = facts.summary["interventions"]
        ends = f"{100 * human['share_first_tenth']:.0f} % first tenth, {100 * human['share_last_tenth']:.0f} % last"
        shown.append(("human share", f"{100 * human['share']:.1f} %", ends))
    elif recent:
        won = sum(end.outcome == episode_end_t.SUCCESS for end in recent)
        shown.append(("success in training", percent(won, len(recent)), f"last {len(recent)} episodes"))
    if facts.episodes:
        steps = facts.episodes[-1].env_steps_total
        seconds = steps / facts.scenario.data["task"].get("policy_rate_hz", 10)
        shown.append(
            ("env steps", str(steps), f"{seconds:.0f} s of robot time, {len(facts.episodes)} episodes")
        )
        peak = max(end.force_peak for end in facts.episodes)
        average = mean([end.force_peak for end in facts.episodes]) or 0.0
        shown.append(
            ("peak force", f"{peak:.0f} N", f"{average:.0f} N mean of the episodes' peaks, in training")
        )
    return shown


def _figures(facts: Facts) -> list[tuple[str, str]]:
    if facts.summary is not None:
        return summary.rows(facts.summary)
    counts: dict[str, int] = {}
    for end in facts.episodes:
        name = OUTCOMES.get(end.outcome, "?")
        counts[name] = counts.get(name, 0) + 1
    found = [("training episodes", ", ".join(f"{n} {name}" for name, n in counts.items()) or "none yet")]
    found.append(("demonstrations", str(len(facts.demonstrations))))
    if facts.progress:
        last = facts.progress[-1]
        found.append(("updates", f"{last['updates']:.0f}, {last['updates_per_s']:.0f} /s"))
    return found


def _evaluation(value: dict[str, Any]) -> tuple[str, str, str, str]:
    steps, force = value.get("steps_mean"), value.get("force", {}).get("peak_mean")
    return (
        str(value["env_steps"]),
        percent(value["successes"], value["episodes"]),
        "-" if steps is None else f"{steps:.1f}",
        "-" if force is None else f"{force:.0f} N",
    )


def differences(mine: Scenario) -> list[tuple[str, str, str]] | None:
    """Key, value of the run, today's default; None when there is no default of that task and method any more."""
    try:
        default = scenario.compose(run_folder.CONFIG, mine.run["task"], mine.run["method"], {})
    except (ScenarioError, KeyError):
        return None
    ours, theirs = mine.leaves(), default.leaves()
    keys = [*ours, *(key for key in theirs if key not in ours)]
    absent = "absent"
    return [
        (key, str(ours.get(key, absent)), str(theirs.get(key, absent)))
        for key in keys
        if ours.get(key, absent) != theirs.get(key, absent)
    ]


def _commands(folder: RunFolder) -> list[tuple[str, str]]:
    run = shown(folder.path)
    return [
        (f"./tandem eval {run} --episodes 200", "evaluate its policy on other seeds"),
        (f"./tandem demo {run}", "see its policy"),
        (f"./tandem spy {run}", "play its log: channels, robot, learning"),
        (f"./tandem log info {run}", "what its log holds"),
        (f"./tandem replay {run}", "compute every torque again, bit for bit"),
        (f"./tandem report {run}", "write this page again"),
        (f"tensorboard --logdir {run}", "its curves beside those of other runs"),
    ]


def _files(folder: RunFolder) -> list[tuple[str, str]]:
    names = (
        "policy.safetensors",
        "summary.json",
        "scenario.yaml",
        "log.lcm",
        "progress.csv",
        "curve.png",
        "demo.mp4",
    )
    there = [folder.path / name for name in names if (folder.path / name).is_file()]
    there += files_of(folder.log)[1:]
    return [(file.name, f"{file.stat().st_size / 1e6:.2f} MB") for file in there]
