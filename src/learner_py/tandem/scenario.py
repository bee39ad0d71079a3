"""Scenarios: one YAML file that reproduces a run.

`compose` joins config/run.yaml (key `run`), config/tasks/TASK.yaml (`task`), config/controller.yaml
(`controller`), config/operator.yaml (`operator`) and config/method.yaml (`method`), lays over them what the
task's `defaults` and then config/methods/METHOD.yaml change, applies `--set a.b=c` and remembers for each
dotted key where its value came from, so that an error of any program points to the line that a person wrote.
"""

import contextlib
import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

SECTIONS = ("run", "task", "controller", "operator", "method")

# Keys of `run` that say how much a log may take, and change nothing of the run.
LOG_LIMITS = ("log_file_mb", "log_quota_mb")

# Larger seeds are kept for evaluation (tandem.evaluation): no training ever saw an evaluation's episodes.
MAX_TRAINING_SEED = 999_999


class ScenarioError(Exception):
    """A sentence for the user: place, value, limit, remedy."""


@dataclass(frozen=True)
class Origin:
    """Where a value was written: a file and its line, or an option of the command line (line 0)."""

    file: str
    line: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}" if self.line else self.file


class _Loader(yaml.SafeLoader):
    """YAML as people mean it: 1e-3 is a number, on/off/yes/no are words."""


_Loader.yaml_implicit_resolvers = {
    first: [
        (tag, regexp)
        for tag, regexp in resolvers
        if tag not in ("tag:yaml.org,2002:bool", "tag:yaml.org,2002:float")
    ]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|false|False)$"), list("tTfF")
)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"^[-+]?(?:\d+\.\d*(?:[eE][-+]?\d+)?|\.\d+(?:[eE][-+]?\d+)?|\d+[eE][-+]?\d+|\.(?:inf|Inf|nan|NaN))$"
    ),
    list("-+0123456789."),
)


class _Dumper(yaml.SafeDumper):
    """One key a line, so that an error's line names one key; lists in a row."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


_Dumper.add_representer(
    list, lambda dumper, data: dumper.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=True)
)


@dataclass
class Scenario:
    """A resolved scenario: `data` by section, `origins` by dotted key (sections and leaves)."""

    data: dict[str, Any]
    origins: dict[str, Origin] = field(default_factory=dict)

    @property
    def run(self) -> dict[str, Any]:
        return self.data["run"]

    @property
    def observation(self) -> list[str]:
        """Names of the numbers that the policy sees. A log from before there was a choice observes the state."""
        return observed(self.run.get("observe", "state"), self.data["task"]["observation"])

    def dumps(self) -> str:
        return yaml.dump(
            self.data,
            Dumper=_Dumper,
            sort_keys=False,
            default_flow_style=False,
            width=110,
            allow_unicode=True,
        )

    def write(self, path: Path) -> None:
        """Writes the file that the other programs read; whole or not at all."""
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(path.name + ".part")
        partial.write_text(self.dumps(), encoding="utf-8")
        partial.replace(path)

    def copy_with(self, **run: Any) -> "Scenario":
        """The same scenario with other values in `run` (an evaluation of it, for instance)."""
        data = {**self.data, "run": {**self.run, **run}}
        return Scenario(data, dict(self.origins))

    def leaves(self) -> dict[str, Any]:
        """Dotted key -> value, lists whole, in file order."""
        return dict(_leaves(self.data, ""))

    def override(self, assignment: str) -> None:
        """Applies one `a.b=c`; c is YAML. Refuses unknown keys, sections and values of another kind."""
        option = f"--set {assignment}"
        key, equals, text = assignment.partition("=")
        key = key.strip()
        if not equals or not key:
            raise ScenarioError(f"{option}: it must read key=value, for instance --set run.env_steps=4000.")
        try:
            value = yaml.load(text, Loader=_Loader)
        except yaml.YAMLError as error:
            raise ScenarioError(f"{option}: the value is not YAML ({_first_line(error)}).") from None
        parent, name = self._find(key, option)
        old = parent[name]
        if isinstance(old, dict):
            inside = ", ".join(f"{key}.{child}" for child in list(old)[:4])
            raise ScenarioError(
                f"{option}: {key} is a section ({self.origins[key]}); set one of its keys ({inside} ...)."
            )
        if _kind(old) != _kind(value) and old is not None:
            raise ScenarioError(
                f"{option}: {key} is {_article(_kind(value))}; it must be {_article(_kind(old))}"
                f" like {_show(old)}"
                f" ({self.origins[key]})."
            )
        parent[name] = value
        self.origins[key] = Origin(option, 0)

    def _find(self, key: str, option: str) -> tuple[dict[str, Any], str]:
        node: Any = self.data
        *parents, name = key.split(".")
        for part in parents:
            node = node.get(part) if isinstance(node, dict) else None
        if isinstance(node, dict) and name in node:
            return node, name
        nearest = _nearest(key, [k for k in self.origins if k not in SECTIONS])
        hint = f"; the nearest is {nearest} ({self.origins[nearest]})" if nearest else ""
        raise ScenarioError(f"{option}: there is no key {key}{hint}.")

    def explain(self, text: str) -> str:
        """Replaces `.../scenario.yaml:LINE: dotted.key` in a program's error by the value's true origin."""
        keys_by_line: dict[int, str] = {}
        with contextlib.suppress(yaml.YAMLError):
            keys_by_line = {
                origin.line: key for key, origin in _origins(self.dumps(), "scenario.yaml").items()
            }

        def true_origin(match: re.Match[str]) -> str:
            named = match["key"] or ""
            for key in (named, keys_by_line.get(int(match["line"]), "")):
                if key in self.origins:
                    return f"{self.origins[key]}: {named}" if named else f"{self.origins[key]}:"
            return match[0]

        return re.sub(
            r"[^\s'\"]*scenario\.yaml:(?P<line>\d+):(?: (?P<key>[A-Za-z_][\w.]*\.\w+))?", true_origin, text
        )

    def first_difference(self, other: "Scenario") -> str | None:
        """A clause about the first key in which the two differ, None when they are the same run."""
        mine, theirs = self.leaves(), other.leaves()
        for key in [*mine, *(k for k in theirs if k not in mine)]:
            if key in (f"run.{name}" for name in LOG_LIMITS):
                continue
            if key not in theirs:
                return f"{key} is {_show(mine[key])} here and absent there"
            if key not in mine:
                return f"{key} is absent here and {_show(theirs[key])} there"
            if mine[key] != theirs[key]:
                return f"{key} is {_show(mine[key])} here and {_show(theirs[key])} there"
        return None


def compose(
    config: Path, task: str, method: str, run: dict[str, Any], overrides: Iterable[str] = ()
) -> Scenario:
    """Joins the files below `config`; `run` holds values from the command's options (None = not given)."""
    files = {
        "run": config / "run.yaml",
        "task": choose(config / "tasks", task, "task"),
        "controller": config / "controller.yaml",
        "operator": config / "operator.yaml",
        "method": config / "method.yaml",
    }
    scenario = Scenario({})
    for section, file in files.items():
        body, origins = read_yaml(file, _display(file, config))
        scenario.data[section] = body
        scenario.origins[section] = Origin(_display(file, config), 1)
        scenario.origins.update({f"{section}.{key}": origin for key, origin in origins.items()})
    _change_by_task(scenario)
    _change_by_method(scenario, config, method)
    _check_run_keys(scenario)
    for key, value in {"task": task, "method": method, **run}.items():
        if value is not None:
            scenario.run[key] = value
            scenario.origins[f"run.{key}"] = Origin(f"--{key.replace('_', '-')}", 0)
    for assignment in overrides:
        scenario.override(assignment)
    validate_run(scenario)
    return scenario


def _change_by_task(scenario: Scenario) -> None:
    """Takes `defaults` out of the task's section and lays it over run.yaml and method.yaml."""
    defaults = scenario.data["task"].pop("defaults", {})
    place = scenario.origins.get("task.defaults")
    if not isinstance(defaults, dict) or not set(defaults) <= {"run", "method"}:
        raise ScenarioError(f"{place}: defaults of a task must be a mapping with the keys run and method.")
    origins = {key: origin for key, origin in scenario.origins.items() if key.startswith("task.defaults")}
    for key in origins:
        del scenario.origins[key]
    for section, changes in defaults.items():
        prefix = f"task.defaults.{section}."
        own = {key.removeprefix(prefix): origins[key] for key in origins if key.startswith(prefix)}
        _lay_over(scenario, section, changes, own)


def _change_by_method(scenario: Scenario, config: Path, method: str) -> None:
    """Lays config/methods/METHOD.yaml over what all methods share."""
    file = choose(config / "methods", method, "method")
    changes, origins = read_yaml(file, _display(file, config))
    if changes.get("name") is None:
        raise ScenarioError(f"{_display(file, config)}: name is missing; it must be {method}.")
    scenario.data["method"].setdefault("name", None)
    _lay_over(scenario, "method", changes, origins)


def _lay_over(scenario: Scenario, section: str, changes: dict[str, Any], origins: dict[str, Origin]) -> None:
    """Replaces values of a section; refuses keys that it does not have."""
    for key, value in _leaves(changes, ""):
        *parents, name = f"{section}.{key}".split(".")
        node: Any = scenario.data
        for part in parents:
            node = node.get(part) if isinstance(node, dict) else None
        if not isinstance(node, dict) or name not in node:
            nearest = _nearest(
                f"{section}.{key}", [k for k in scenario.origins if k.startswith(f"{section}.")]
            )
            hint = f"; the nearest is {nearest}" if nearest else ""
            raise ScenarioError(f"{origins[key]}: there is no key {section}.{key}{hint}.")
        node[name] = value
    scenario.origins.update({f"{section}.{key}": origin for key, origin in origins.items()})


def load(path: Path) -> Scenario:
    """Reads a resolved scenario (RUN/scenario.yaml)."""
    data, origins = read_yaml(path, str(path))
    for section in SECTIONS:
        if not isinstance(data.get(section), dict):
            raise ScenarioError(f"{path}: the section {section} is missing; this is not a resolved scenario.")
    return Scenario(data, origins)


def read_yaml(path: Path, display: str) -> tuple[dict[str, Any], dict[str, Origin]]:
    """Mapping of a YAML file and the origin of each dotted key; refuses duplicates and non-mappings."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ScenarioError(f"{display} can't be read ({error.strerror}).") from None
    try:
        origins = _origins(text, display)
        data = yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"{display}:{mark.line + 1}" if mark else display
        raise ScenarioError(f"{place}: this is not YAML ({_first_line(error)}).") from None
    if not isinstance(data, dict):
        raise ScenarioError(f"{display}: it must hold keys and values, but holds {_article(_kind(data))}.")
    return data, origins


_RANGES: dict[str, tuple[int, int]] = {
    "demonstrations": (0, 1000),
    "env_steps": (1, 10_000_000),
    "learner_lag": (0, 10),
    "evaluation_every": (1, 10_000_000),
    "evaluation_episodes": (1, 10_000),
    "fresh_episodes": (1, 10_000),
    "video_episodes": (0, 100),
    "episodes": (1, 10_000),
    "robot_state_hz": (0, 1000),
    **dict.fromkeys(LOG_LIMITS, (0, 100_000_000)),
}
_CHOICES = {
    "mode": ("train", "evaluate", "demonstrate", "bench"),
    "clock": ("lockstep", "realtime"),
    "observe": ("state", "image"),
}
_RUN_KEYS = ("task", "method", "seed", "policy", *_CHOICES, *_RANGES)


def _check_run_keys(scenario: Scenario) -> None:
    for key in scenario.run:
        if key not in _RUN_KEYS:
            nearest = _nearest(key, list(_RUN_KEYS))
            hint = f"; the nearest is {nearest}" if nearest else ""
            raise ScenarioError(f"{scenario.origins[f'run.{key}']}: there is no key run.{key}{hint}.")
    for key in _RUN_KEYS:
        if key not in scenario.run:
            raise ScenarioError(f"{scenario.origins['run'].file}: run.{key} is missing.")


def validate_run(scenario: Scenario) -> None:
    """Checks the section `run`; the other sections are checked by the programs that read them."""

    def refuse(key: str, rule: str) -> None:
        raise ScenarioError(
            f"{scenario.origins[f'run.{key}']}: run.{key} is {_show(scenario.run[key])}; it must be {rule}."
        )

    for key, choices in _CHOICES.items():
        if scenario.run[key] not in choices:
            refuse(key, "one of " + ", ".join(choices))
    for key, (low, high) in {"seed": (0, MAX_TRAINING_SEED), **_RANGES}.items():
        value = scenario.run[key]
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            refuse(key, f"a whole number in [{low}, {high}]")
    for key in ("task", "method", "policy"):
        if not isinstance(scenario.run[key], str):
            refuse(key, "a text")


def observed(observe: str, terms: list[str]) -> list[str]:
    """Names of the numbers that a policy is told. With images: without what it can see for itself."""
    if observe == "state":
        return terms
    return [term for term in terms if not term.startswith(("goal_", "object_"))]


def names(folder: Path) -> list[str]:
    """Names of the scenario files in a folder (tasks, methods)."""
    return sorted(file.stem for file in folder.glob("*.yaml"))


def choose(folder: Path, name: str, what: str) -> Path:
    """The scenario file of that name. @raises ScenarioError with the names that there are."""
    known = names(folder)
    if name in known:
        return folder / f"{name}.yaml"
    nearest = _nearest(name, known)
    hint = f" Did you mean {nearest}?" if nearest else ""
    raise ScenarioError(f"There is no {what} {name!r}; there are: {', '.join(known) or 'none'}.{hint}")


def _origins(text: str, display: str) -> dict[str, Origin]:
    """Dotted key -> origin, of a YAML text; inside lists with the item's number, e.g. `variants.0.label`."""
    found: dict[str, Origin] = {}

    def walk(node: yaml.Node, prefix: str) -> None:
        if isinstance(node, yaml.SequenceNode):
            for number, item in enumerate(node.value):
                walk(item, f"{prefix}{number}.")
        if not isinstance(node, yaml.MappingNode):
            return
        for key_node, value_node in node.value:
            key = prefix + str(key_node.value)
            line = key_node.start_mark.line + 1
            if key in found:
                raise ScenarioError(
                    f"{display}:{line}: {key} is given twice, first in line {found[key].line}."
                )
            found[key] = Origin(display, line)
            walk(value_node, key + ".")

    root = yaml.compose(text, Loader=_Loader)
    if root is not None:
        walk(root, "")
    return found


def _leaves(node: dict[str, Any], prefix: str) -> Iterable[tuple[str, Any]]:
    for key, value in node.items():
        if isinstance(value, dict) and value:
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _nearest(key: str, known: list[str]) -> str | None:
    """The known name most like `key`; names with the same last part go first."""
    same_end = [k for k in known if k.rsplit(".", 1)[-1] == key.rsplit(".", 1)[-1]]
    matches = difflib.get_close_matches(key, same_end or known, n=1, cutoff=0.0 if same_end else 0.5)
    return matches[0] if matches else None


def _kind(value: Any) -> str:
    if isinstance(value, bool):
        return "truth value"
    if isinstance(value, int | float):
        return "number"
    if isinstance(value, list):
        return "list"
    if isinstance(value, dict):
        return "section"
    return "nothing" if value is None else "text"


def _article(kind: str) -> str:
    return kind if kind == "nothing" else f"a {kind}"


def _show(value: Any) -> str:
    return (
        str(value).lower()
        if isinstance(value, bool)
        else repr(value)
        if isinstance(value, str)
        else str(value)
    )


def _display(file: Path, config: Path) -> str:
    return str(Path(config.name) / file.relative_to(config))


def _first_line(error: Exception) -> str:
    return str(getattr(error, "problem", None) or error).splitlines()[0]
