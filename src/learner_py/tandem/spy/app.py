"""The terminal view: five pages over a Model, fed by a live or a recorded source. No figure is computed here."""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

from rich.table import Table
from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.coordinate import Coordinate
from textual.widgets import DataTable, Footer, Static, TabbedContent, TabPane, Tree
from textual.widgets.tree import TreeNode

from tandem.spy import channel_table, learning_page, robot_page
from tandem.spy.fields import members, sparkline, text
from tandem.spy.live import LiveSource, evaluations
from tandem.spy.model import Model
from tandem.spy.recording import RecordedSource

EVALUATIONS_S = 5.0  # between two looks into the run folder
SEEK_US = 5_000_000
LABEL = 34  # characters for name and value of a member before its sparkline

Source = LiveSource | RecordedSource


class Spy(App[None]):
    """Ends by `q`, or after `seconds`."""

    CSS = """
    Screen { overflow: hidden; }
    TabbedContent { height: 1fr; }
    #where { height: 1; background: $panel; padding: 0 1; }
    TabPane { padding: 0; }
    DataTable, Tree { height: 1fr; }
    #members-of { height: 1; color: $text-muted; padding: 0 1; }
    VerticalScroll { padding: 0 1; }
    """
    ENABLE_COMMAND_PALETTE = False
    _PLAYING: ClassVar[frozenset[str]] = frozenset({"step", "speed", "seek", "episode", "edge"})

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("1", "page('channels')", "Channels", show=False),
        Binding("2", "page('fields')", "Fields", show=False),
        Binding("3", "page('robot')", "Robot", show=False),
        Binding("4", "page('learning')", "Learning", show=False),
        Binding("5", "page('events')", "Events", show=False),
        Binding("space", "pause", "Pause", priority=True),
        Binding("full_stop", "step", "Step", key_display="."),
        Binding("plus,equals_sign", "speed(1)", "Faster", key_display="+"),
        Binding("minus", "speed(-1)", "Slower", key_display="-"),
        Binding("left", "seek(-1)", "-5s", priority=True),
        Binding("right", "seek(1)", "+5s", priority=True),
        Binding("p", "episode(-1)", "Episode -"),
        Binding("n", "episode(1)", "+"),
        Binding("home", "edge(0)", "Begin", show=False, priority=True),
        Binding("end", "edge(1)", "End", show=False, priority=True),
        Binding("q", "quit", "Quit"),
    ]

    def __init__(
        self,
        source: Source,
        new_model: Callable[[], Model],
        run: Path | None = None,
        seconds: float | None = None,
    ) -> None:
        super().__init__()
        self.source = source
        self.new_model = new_model
        self.model = new_model()
        self.frozen = False  # a live view that stands still; reception goes on
        self._run_folder = run
        self._seconds = seconds
        self._evaluated: list[dict[str, Any]] = []
        self._looked = -EVALUATIONS_S
        self._shown: dict[str, list[Text]] = {}  # cells of the table of channels
        self._shown_width = 0
        self._encoding = sys.stdout.encoding or "ascii"

    # ---- the screen

    def compose(self) -> ComposeResult:
        yield Static(id="where")
        with TabbedContent(initial="channels"):
            with TabPane("1 Channels", id="channels"):
                yield DataTable(cursor_type="row", cell_padding=0, zebra_stripes=True)
            with TabPane("2 Fields", id="fields"):
                yield Static("Enter on a channel of page 1 shows its members here.", id="members-of")
                yield Tree[str]("")
            with TabPane("3 Robot", id="robot"), VerticalScroll():
                yield Static(id="robot-rows")
            with TabPane("4 Learning", id="learning"), VerticalScroll():
                yield Static(id="learning-rows")
            with TabPane("5 Events", id="events"), VerticalScroll():
                yield Static(id="event-rows")
        yield Footer(compact=True, show_command_palette=False)

    def on_mount(self) -> None:
        self.query_one(DataTable).focus()
        self.query_one(Tree).show_root = False
        self.set_interval(self.source.refresh_s, self._tick)
        if self._seconds is not None:
            self.set_timer(self._seconds, self.exit)
        self._tick()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """A live source can't be stepped or sought."""
        return action not in self._PLAYING or isinstance(self.source, RecordedSource)

    def _tick(self) -> None:
        self.model.take(self.source.poll())
        if not self.frozen:
            self._refresh()

    def _refresh(self) -> None:
        if not self.query("#where"):  # a timer's last call, while the screen is taken down
            return
        self.query_one("#where", Static).update(self._where())
        page = self.query_one(TabbedContent).active
        if page == "channels":
            self._refresh_channels()
        elif page == "fields":
            self._refresh_fields()
        elif page == "robot":
            self._show_rows("#robot-rows", robot_page.rows(self.model, self._encoding))
        elif page == "learning":
            self._show_rows("#learning-rows", learning_page.rows(self.model, self._look(), self._encoding))
        else:
            self._refresh_events()

    def _where(self) -> Text:
        shown = Text(no_wrap=True, overflow="ellipsis")
        if isinstance(self.source, LiveSource):
            n = sum(channel.count for channel in self.model.channels.values())
            shown.append(*(("frozen", "bold yellow") if self.frozen else ("live", "bold green")))
            shown.append(f"  {self.source.title}  {n} messages in {self.model.elapsed_s:.0f} s")
            return shown
        source = self.source
        begin, end = source.recording.begin_us, source.recording.end_us
        state = "at the end" if source.ended else "paused" if source.paused else f"{source.speed:g} x"
        shown.append(state, "bold yellow" if source.paused or source.ended else "bold green")
        at, length = (source.position_us - begin) / 1e6, (end - begin) / 1e6
        world = self.model.latest("WORLD_STATE")
        place = f", episode {world.episode}, step {world.step}" if world is not None else ""
        shown.append(f"  {at:.2f} of {length:.0f} s{place}  {source.title}")
        return shown

    def _refresh_channels(self) -> None:
        table: DataTable[Text] = self.query_one(DataTable)
        width = self.size.width
        columns = channel_table.columns(width)
        if width != self._shown_width:
            self._shown_width = width
            self._shown = {}
            table.clear(columns=True)
            for column in columns:
                title = column.title if column.left else column.title.rjust(column.width)
                table.add_column(title, width=column.width + 1)
        rows = self.model.rows()
        names = [row.channel for row in rows]
        if names != list(self._shown):  # a new channel: by name, so all move; the cursor stays on its own
            at = list(self._shown)[table.cursor_row] if self._shown else ""
            table.clear()
            self._shown = {}
            for row in rows:
                self._shown[row.channel] = channel_table.cells(row, width)
                table.add_row(*self._shown[row.channel], key=row.channel)
            if at in names:
                table.move_cursor(row=names.index(at))
            return
        for i, row in enumerate(rows):
            cells, before = channel_table.cells(row, width), self._shown[row.channel]
            for j, cell in enumerate(cells):
                if cell != before[j] or cell.style != before[j].style:
                    table.update_cell_at(Coordinate(i, j), cell)
            self._shown[row.channel] = cells

    def on_data_table_row_selected(self, event: DataTable.RowSelected) -> None:
        """Enter on a channel: its members."""
        if event.row_key.value:
            self.show_fields(event.row_key.value)

    def show_fields(self, channel: str) -> None:
        if channel != self.model.chosen:
            self.query_one(Tree).clear()
        self.model.choose(channel)
        self.action_page("fields")

    def _refresh_fields(self) -> None:
        chosen = self.model.chosen
        if chosen is None:
            return
        found = self.model.channels.get(chosen)
        message = self.model.latest(chosen)
        kind = found.layout.name if found and found.layout else "not a type of ours"
        note = "" if message is not None else ": " + _raw(found.raw if found else None)
        self.query_one("#members-of", Static).update(f"{chosen}  {kind}{note}")
        if message is not None:
            self._update_node(self.query_one(Tree).root, message, "")

    def _update_node(self, node: TreeNode[str], value: Any, path: str) -> None:
        """Brings the labels below a node up to date; only what is open has children."""
        below = members(value)
        if [child.data for child in node.children] != [name for name, _ in below]:
            node.remove_children()
            for name, item in below:
                node.add("", data=name, allow_expand=bool(members(item)))
        for child, (name, item) in zip(node.children, below, strict=True):
            here = path + name if name.startswith("[") or not path else f"{path}.{name}"
            label = Text(f"{name} ").append(text(item), style="bold")
            if history := self.model.fields.of(here):
                label.append(" " * max(1, LABEL - len(label)))
                label.append(sparkline(history, encoding=self._encoding), style="cyan")
            if child.label != label:
                child.set_label(label)
            if child.is_expanded:
                self._update_node(child, item, here)

    def _show_rows(self, where: str, rows: list[tuple[str, Text]]) -> None:
        grid = Table.grid(padding=(0, 2))
        grid.add_column(style="bold", no_wrap=True)
        grid.add_column()
        for label, line in rows:
            grid.add_row(label, line)
        self.query_one(where, Static).update(grid)

    def _look(self) -> list[dict[str, Any]]:
        """Evaluations in the run folder; in a log only those of its past."""
        if time.monotonic() - self._looked > EVALUATIONS_S:
            self._looked = time.monotonic()
            self._evaluated = evaluations(self._run_folder)
        if isinstance(self.source, LiveSource):
            return self._evaluated
        recent = self.model.progress.recent
        steps = recent[-1].env_steps_total if recent else -1
        return [value for value in self._evaluated if value["env_steps"] <= steps]

    def _refresh_events(self) -> None:
        grid = Table.grid(padding=(0, 2))
        grid.add_column(justify="right", style="dim")
        grid.add_column()
        for event in reversed(self.model.events):
            grid.add_row(f"{event.at_s:.1f} s", Text(event.text, style=event.style))
        self.query_one("#event-rows", Static).update(grid if self.model.events else "nothing happened yet")

    # ---- keys

    def action_page(self, page: str) -> None:
        self.query_one(TabbedContent).active = page
        focus = {"channels": "DataTable", "fields": "Tree"}.get(page, f"#{page} VerticalScroll")
        self.query_one(focus).focus()
        self._refresh()

    def on_tabbed_content_tab_activated(self, _event: TabbedContent.TabActivated) -> None:
        self._refresh()

    def on_tree_node_expanded(self, _event: Tree.NodeExpanded[str]) -> None:
        self._refresh()

    def action_pause(self) -> None:
        if isinstance(self.source, RecordedSource):
            self.source.paused = not self.source.paused
        else:
            self.frozen = not self.frozen
        self.query_one("#where", Static).update(self._where())

    def action_step(self) -> None:
        self._recorded.step()
        self._tick()

    def action_speed(self, by: int) -> None:
        self._recorded.faster() if by > 0 else self._recorded.slower()
        self._tick()

    def action_seek(self, by: int) -> None:
        self._seek(self._recorded.position_us + by * SEEK_US)

    def action_episode(self, by: int) -> None:
        at = self._recorded.episode_at(by)
        if at is None:
            self.notify("The log's episodes are still being counted; once more in a moment.")
        else:
            self._seek(at)

    def action_edge(self, which: int) -> None:
        recording = self._recorded.recording
        self._seek(recording.end_us if which else recording.begin_us)

    @property
    def _recorded(self) -> RecordedSource:
        assert isinstance(self.source, RecordedSource)
        return self.source

    def _seek(self, to_us: int) -> None:
        chosen = self.model.chosen
        before = self._recorded.seek(to_us)
        self.model = self.new_model()
        self.model.recall(before)
        self.model.choose(chosen)
        self._tick()


def _raw(data: bytes | None) -> str:
    """The beginning of a message that we can't decode."""
    return "nothing yet" if data is None else f"{len(data)} bytes, {data[:24].hex(' ')}"
