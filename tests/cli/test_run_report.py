"""RUN/report.html, read by a real browser, and RUN/tensorboard, read back record by record."""

import html
import io
import json
import re
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import lcm
import pytest
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.learner_status_t import learner_status_t
from tandem_lcm.tandem.world_state_t import world_state_t
from typer.testing import CliRunner

from tandem import run_folder, run_report, summary
from tandem.cli.app import app
from tandem.live_plots import LivePlots
from tandem.live_view import Progress
from tandem.run_charts import POINTS, thinned
from tandem.run_folder import RunFolder, write_json
from tandem.scenario import compose

EPISODES = 30
HISTOGRAM = {"bucket_us": 1.0, "counts": [0, 50, 900, 40, 0, 1, 0], "max_us": 5.2}


def episode(number: int) -> Any:
    end = episode_end_t()
    end.episode, end.phase = number, world_state_t.TRAINING
    end.outcome = episode_end_t.TIMEOUT if number % 5 == 0 else episode_end_t.SUCCESS
    end.n_steps, end.n_intervention_steps, end.n_takeovers = 10, max(0, 8 - number), int(number < 8)
    end.force_peak, end.force_filtered_peak = 50.0 + number, 20.0
    end.env_steps_total, end.policy_version = 10 * (number + 1), number + 1
    return end


@pytest.fixture
def run(config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RunFolder:
    """A real-time run in the middle of its training."""
    monkeypatch.setattr(run_folder, "CONFIG", config)
    folder = RunFolder(tmp_path / "a run")
    compose(config, "peg", "tandem", {"clock": "realtime"}, ["controller.clip=0.25"]).write(folder.scenario)
    log = lcm.EventLog(str(folder.log), "w", overwrite=True)
    for number in range(EPISODES):
        log.write_event(number, "EPISODE_END", episode(number).encode())
    log.close()
    rows = [f"{i},{10 * i},{i},{100 * i},500,{0.1 / (i + 1)},0.5,0.4,0.9,0.3,250" for i in range(EPISODES)]
    folder.progress.write_text("\n".join([",".join(summary.PROGRESS_COLUMNS), *rows]) + "\n")
    for steps, won in ((0, 4), (100, 9), (200, 10)):
        value = {
            "env_steps": steps,
            "successes": won,
            "episodes": 10,
            "steps_mean": 12.5,
            "force": {"peak_mean": 33.0},
        }
        write_json(folder.evaluation(steps), value)
    loop = {
        "tick_compute_histogram_us": HISTOGRAM,
        "wakeup_histogram_us": HISTOGRAM,
        "ticks": 991,
        "overruns": 7,
    }
    write_json(folder.path / "controller.json", loop)
    return folder


def browsed(page: Path, profile: Path) -> tuple[str, list[str], list[str]]:
    """(DOM after loading, lines of its console, addresses that it asked for) in headless Chromium."""
    browser = shutil.which("chromium")
    assert browser, "chromium is missing; ./tandem test sets it up (scripts/debian-packages-test.txt)"
    network = profile.with_suffix(".net.json")
    done = subprocess.run(
        [
            browser, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
            "--disable-component-update", "--disable-extensions", "--host-resolver-rules=MAP * ~NOTFOUND",
            f"--user-data-dir={profile}", "--enable-logging=stderr", f"--log-net-log={network}",
            "--virtual-time-budget=2000", "--dump-dom", page.as_uri(),
        ],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    log = json.loads(network.read_text())
    begins = log["constants"]["logEventTypes"]["URL_REQUEST_START_JOB"]
    asked = [
        event["params"]
        for event in log["events"]
        if event["type"] == begins and "url" in event.get("params", {})
    ]
    # what the browser itself looks for (updates, the time) comes from no page
    return done.stdout, console, [one["url"] for one in asked if one.get("initiator") != "not an origin"]


def words(dom: str) -> str:
    return " ".join(html.unescape(re.sub(r"<style.*?</style>|<[^>]*>", " ", dom, flags=re.DOTALL)).split())


def test_a_browser_shows_every_figure_and_asks_nobody(run: RunFolder, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["report", str(run.path)])
    assert result.exit_code == 0, result.output
    dom, console, asked = browsed(run.report, tmp_path / "profile")
    assert console == [] and asked == []
    shown = words(dom)
    for figure in (
        "peg · tandem · seed 0",
        "not finished: 300 of 60 env steps so far",
        "80.0 % [58.4, 91.9] (16/20)",  # of the last 20 episodes
        "79 N",
        "30 s of robot time",
        "24 success",
        "6 timeout",
        "90.0 % [59.6, 98.2] (9/10)",  # of a checkpoint
        "controller.clip 0.25 0.01",
        "run.clock realtime lockstep",
        "7 overruns in 991 ticks",
        "computing a tick: p50 3",
        "./tandem replay",
    ):
        assert figure in shown, figure
    assert dom.count("<svg") == 6 and dom.count("<path") > 50
    ids = re.findall(r'\bid="([^"]+)"', dom)
    assert len(ids) == len(set(ids))
    for used in re.findall(r'(?:href="#|url\(&quot;#|url\(#)([^")&]+)', dom):
        assert used in ids, used


def test_the_browser_would_tell_a_page_that_asks_for_something(run: RunFolder, tmp_path: Path) -> None:
    page = run_report.write(run).read_text()
    bad = tmp_path / "bad.html"
    bad.write_text(page.replace("</body>", '<img src="http://example.invalid/x.png"></body>'))
    assert browsed(bad, tmp_path / "one")[1] != []  # the page's own policy forbids it, in the console
    bad.write_text(
        re.sub(r"<meta http-equiv.*?>", "", page).replace(
            "</body>", '<img src="http://example.invalid/x.png"></body>'
        )
    )
    assert browsed(bad, tmp_path / "two")[2] == ["http://example.invalid/x.png"]


def test_text_from_a_scenario_is_never_markup(run: RunFolder) -> None:
    text = run.scenario.read_text()
    run.scenario.write_text(text.replace("skilled: true", "skilled: '<script>alert(1)</script>'"))
    page = run_report.write(run).read_text()
    assert "<script" not in page and "&lt;script&gt;" in page


def test_a_run_without_anything_yet_has_a_page(config: Path, tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "new")
    compose(config, "peg", "tandem", {}, []).write(folder.scenario)
    page = words(run_report.write(folder).read_text())
    assert "0 of 60 env steps so far" in page and "Nothing to draw yet" in page


def test_what_is_no_run_folder_is_refused_with_a_sentence(tmp_path: Path) -> None:
    for folder, said in ((tmp_path, "it has no scenario.yaml"), (tmp_path / "no", "is not a run folder")):
        result = CliRunner().invoke(app, ["report", str(folder)])
        assert result.exit_code != 0 and said in result.output.replace("\n", " ")


def test_long_curves_are_thinned_out_and_keep_their_ends() -> None:
    some = thinned(range(100_000))
    assert len(some) == POINTS and some[0] == 0 and some[-1] == 99_999
    assert thinned([1, 2]) == [1, 2]


# ---- TensorBoard


def scalars(folder: Path) -> list[tuple[str, int, float]]:
    """(tag, step, value) of every event file, in order; lengths and checksums as the format wants them."""
    from tensorboardX.proto.event_pb2 import Event
    from tensorboardX.record_writer import masked_crc32c as masked

    found = []
    for file in sorted(folder.iterdir()):
        data = file.read_bytes()
        while data:
            head = data[:8]
            (n,) = struct.unpack("<Q", head)
            body = data[12 : 12 + n]
            assert struct.unpack("<I", data[8:12]) == (masked(head),)
            assert struct.unpack("<I", data[12 + n : 16 + n]) == (masked(body),)
            event = Event.FromString(body)
            found += [(value.tag, event.step, value.simple_value) for value in event.summary.value]
            data = data[16 + n :]
    return found


def plotted(folder: Path, said: list[str]) -> LivePlots:
    plots, progress = LivePlots(folder, said.append, {}), Progress()
    status = learner_status_t()
    status.critic_loss, status.win_share, status.buffer_steps = 0.25, float("nan"), 400
    for number in range(3):
        progress.on_episode(episode(number))
        plots.episode(episode(number), progress)
        plots.learner(10 * (number + 1), status)
    results = {20: {"successes": 9, "episodes": 10, "steps_mean": None}}
    plots.evaluations(results)
    plots.evaluations(results)  # looked at ten times a second, written once
    return plots


def test_event_files_hold_the_figures_over_env_steps(tmp_path: Path) -> None:
    said: list[str] = []
    plots = plotted(tmp_path / "tensorboard", said)
    found = scalars(tmp_path / "tensorboard")  # before it is closed: one looks on while it goes
    plots.close()
    assert [one for one in found if one[0] == "success/evaluation"] == [
        ("success/evaluation", 20, pytest.approx(0.9))
    ]
    assert [one[1:] for one in found if one[0] == "losses/critic"] == [(10, 0.25), (20, 0.25), (30, 0.25)]
    assert ("learner/buffer_steps", 30, 400.0) in found and ("force/peak_N", 30, 52.0) in found
    assert ("success/recent_episodes", 10, 0.0) in found and not any(one[0] == "wins/all" for one in found)
    assert ("human/share_recent", 30, pytest.approx(0.7)) in found
    # an evaluation of an earlier call is not written again
    LivePlots(tmp_path / "other", said.append, {20: {}}).evaluations({20: {"successes": 1, "episodes": 1}})
    assert not (tmp_path / "other").exists() and said == []


def test_a_folder_that_cannot_be_written_costs_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "tensorboard").write_text("a file where the folder should be")
    said: list[str] = []
    plots = plotted(tmp_path / "tensorboard", said)
    assert plots.failures == 7 and len(said) == 1 and "the run goes on" in said[0]
    plots.close()


def test_a_disk_that_is_full_for_a_while_leaves_a_gap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    plots = plotted(tmp_path / "tensorboard", said)
    plots.close()
    with monkeypatch.context() as disk:
        disk.setattr(plots, "_open", lambda: io.FileIO("/dev/full", "wb"))
        plots.evaluations({40: {"successes": 1, "episodes": 2}})
    plots.evaluations({60: {"successes": 2, "episodes": 2}})
    plots.close()
    assert plots.failures == 1 and len(said) == 1 and "No space left" in said[0]
    assert ("success/evaluation", 60, 1.0) in scalars(tmp_path / "tensorboard")
