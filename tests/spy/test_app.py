"""The terminal view and the command, with real keys, real LCM and a real log."""

import asyncio
import json
import threading
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import lcm
from spy_messages import robot, status
from textual.widgets import DataTable, Static, Tree
from typer.testing import CliRunner

from tandem.cli.app import app
from tandem.processes import free_lcm_url
from tandem.spy.app import Spy
from tandem.spy.live import LiveSource
from tandem.spy.model import Model
from tandem.spy.recording import RecordedSource

SMALL = (80, 24)


def screen(spy: Spy) -> str:
    return "\n".join(strip.text for strip in spy.screen._compositor.render_strips())


def run(log: Path, steps: Callable[[Spy, Any], Coroutine[Any, Any, None]]) -> None:
    async def main() -> None:
        source = RecordedSource(log, log.parent)
        source._reader.join()
        spy = Spy(source, lambda: Model(robot_time=True), log.parent)
        async with spy.run_test(size=SMALL) as pilot:
            await steps(spy, pilot)
        source.close()

    asyncio.run(main())


def test_every_page_shows_its_figures_on_80_by_24(log: Path) -> None:
    async def steps(spy: Spy, pilot: Any) -> None:
        await pilot.press("end", "space")
        await pilot.pause()
        page = screen(spy)
        assert "EPISODE_END" in page and "ROBOT_STATE" in page and "100.0" in page
        assert "paused" in page or "at the end" in page
        for key, words in {"3": "authority", "4": "success", "5": "episode 3 (training)"}.items():
            await pilot.press(key)
            await pilot.pause()
            assert words in screen(spy), screen(spy)
        await pilot.press("4")
        await pilot.pause()
        assert "(4/4) of the last 4" in screen(spy)  # those before the moment as well

    run(log, steps)


def test_enter_on_a_channel_opens_the_tree_of_its_members(log: Path) -> None:
    async def steps(spy: Spy, pilot: Any) -> None:
        await pilot.press("end", "space")
        await pilot.pause()
        table = spy.query_one(DataTable)
        table.move_cursor(row=table.get_row_index("ROBOT_STATE"))
        await pilot.press("enter")
        await pilot.pause()
        assert "ROBOT_STATE  robot_state_t" in screen(spy)
        tree = spy.query_one(Tree)
        node = next(child for child in tree.root.children if child.data == "F_ext_W")
        tree.move_cursor(node)
        await pilot.press("enter")
        await pilot.pause()
        assert [child.data for child in node.children] == [f"[{i}]" for i in range(6)]
        assert "[2] 2" in str(node.children[2].label)

    run(log, steps)


def test_keys_pause_step_seek_and_change_speed(log: Path) -> None:
    async def steps(spy: Spy, pilot: Any) -> None:
        source = spy.source
        assert isinstance(source, RecordedSource)
        await pilot.press("space")
        assert source.paused
        at = source.position_us
        await pilot.press("full_stop")
        await pilot.pause()
        assert at < source.position_us <= at + 200_000
        await pilot.press("plus", "plus", "minus")
        assert source.speed == 2.0
        await pilot.press("right")
        await pilot.pause()
        assert source.position_us >= 5_000_000
        await pilot.press("n")
        await pilot.pause()
        assert source.position_us > 12_000_000
        await pilot.press("home")
        await pilot.pause()
        assert source.position_us == 0
        assert "paused" in str(spy.query_one("#where", Static).render())

    run(log, steps)


@contextmanager
def published(url: str) -> Iterator[None]:
    """A busy network for as long as the context lasts: however slow the machine is, something is there to hear."""
    ended = threading.Event()

    def publish() -> None:
        link = lcm.LCM(url)
        tick = 0
        while not ended.wait(0.005):
            tick += 10
            if tick % 50:  # one of five never goes out
                link.publish("ROBOT_STATE", robot(0, tick).encode())
            link.publish("CONTROLLER_STATUS", status(lockstep=0).encode())
            link.publish("NOT_OURS", b"hello")

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def test_live_view_shows_what_is_published_and_can_be_frozen() -> None:
    async def main() -> None:
        url = free_lcm_url()
        source = LiveSource(url)
        spy = Spy(source, Model)
        with published(url):
            async with spy.run_test(size=SMALL) as pilot:
                await pilot.pause(1.2)
                assert "ROBOT_STATE" in screen(spy) and "NOT_OURS" in screen(spy) and "live" in screen(spy)
                assert "Step" not in screen(spy)  # nothing to step through
                await pilot.press("space")
                before = screen(spy)
                await pilot.pause(0.8)
                assert "frozen" in screen(spy)
                assert screen(spy).split("\n")[4:] == before.split("\n")[4:]
        source.close()

    asyncio.run(main())


def test_once_prints_a_table_and_writes_the_figures(tmp_path: Path) -> None:
    url, file = free_lcm_url(), tmp_path / "spy.json"
    with published(url):
        result = CliRunner().invoke(
            app, ["spy", "--once", "--seconds", "1.5", "--lcm", url, "--json", str(file)]
        )
    assert result.exit_code == 0, result.output
    assert "ROBOT_STATE" in result.output and "controller_status_t" in result.output
    value = json.loads(file.read_text())
    rows = {row["channel"]: row for row in value["channels"]}
    assert rows["ROBOT_STATE"]["gaps"] == value["gaps"] > 0
    assert rows["ROBOT_STATE"]["expected_hz"] == 100.0
    assert rows["NOT_OURS"]["undecodable"] == rows["NOT_OURS"]["count"] == value["undecodable"]


def test_once_reads_a_whole_log_and_refuses_nonsense_with_a_sentence(log: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["spy", str(log), "--json", "-"])  # no terminal: once by itself
    assert result.exit_code == 0
    assert "800" in result.output and "EPISODE_END" in result.output
    silent = CliRunner().invoke(app, ["spy", "--once", "--seconds", "0.3", "--lcm", free_lcm_url()])
    assert silent.exit_code == 1 and "not a single message" in silent.output
    (tmp_path / "text.lcm").write_text("not a log")
    for words, said in (
        ([str(tmp_path / "nothing")], "does not exist"),
        ([str(tmp_path / "text.lcm")], "holds no whole event"),
        ([str(log), "--lcm", "memq://"], "not both"),
        (["--once", "--lcm", "nonsense://"], "LCM does not open"),
    ):
        refused = CliRunner().invoke(app, ["spy", *words])
        assert refused.exit_code != 0 and said in refused.output, refused.output
        assert "Traceback" not in refused.output
