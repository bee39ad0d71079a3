"""`tandem doctor`: what this machine can do for Tandem, and what each finding means."""

import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import typer

from tandem.cli.common import JsonOption, write_json
from tandem.run_folder import ROOT, program


@dataclass
class Finding:
    """ok; note: works, with a drawback; bad: `train` can't run."""

    name: str
    state: Literal["ok", "note", "bad"]
    text: str


def doctor(json_file: JsonOption = None) -> None:
    """Check this machine: programs, LCM, real time, drawing, CPU, space. Exit code 0 when `train` can run."""
    from rich.console import Console
    from rich.text import Text

    console = Console()
    findings = []
    for check in CHECKS:
        try:
            found = check()
        except Exception as error:  # a check that breaks is a finding, not a crash
            found = [Finding(check.__name__.strip("_"), "bad", f"the check itself failed: {error}")]
        for finding in found:
            colour = {"ok": "green", "note": "yellow", "bad": "red"}[finding.state]
            console.print(
                Text.assemble((f"{finding.state:<5}", colour), (f"{finding.name:<16}", "bold"), finding.text),
                soft_wrap=True,
            )
        findings += found
    fit = all(finding.state != "bad" for finding in findings)
    print("train can run here." if fit else "train can't run here; mend what is marked bad.")
    write_json(json_file, {"fit": fit, "findings": [asdict(finding) for finding in findings]})
    raise typer.Exit(0 if fit else 1)


def _output(*command: str, environment: dict[str, str] | None = None) -> str | None:
    """stdout of a command, None when it fails or is missing."""
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=20, env={**os.environ, **(environment or {})}
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def _programs() -> list[Finding]:
    def missing(*names: str) -> list[str]:
        return [name for name in names if not os.access(program(name), os.X_OK)]

    if lost := missing("tandem_controller", "tandem_operator"):
        return [Finding("programs", "bad", f"not built: {', '.join(lost)}; see .setup/build.log")]
    if missing("tandem_render"):
        text = "tandem_render is not built: training works, demo.mp4 doesn't; see .setup/build.log"
        return [Finding("programs", "note", text)]
    return [Finding("programs", "ok", f"built, in {program('tandem_controller').parent}")]


def _versions() -> list[Finding]:
    import importlib
    from importlib.metadata import version

    found = []
    try:
        for name in ("lcm", "jax", "optax", "safetensors", "pydantic"):
            importlib.import_module(name)
        text = ", ".join(f"{name} {version(name)}" for name in ("lcm", "jax", "numpy", "safetensors"))
        found.append(Finding("python", "ok", f"{platform.python_version()}; {text}"))
    except ImportError as error:
        found.append(Finding("python", "bad", f"{error}; remove .setup/venv.stamp and call ./tandem again"))
    mujoco = _output("dpkg-query", "-W", "-f", "${Version}", "libmujoco-dev") or "unknown"
    compiler = (_output("c++", "--version") or "no compiler").splitlines()[0]
    cmake = (_output("cmake", "--version") or "no cmake").splitlines()[0]
    found.append(Finding("build tools", "ok", f"MuJoCo {mujoco}; {compiler}; {cmake}"))
    return found


def _ray() -> list[Finding]:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return [Finding("Ray", "ok", f"{version('ray')}: table and ablate can run on it by --ray")]
    except PackageNotFoundError:
        text = (
            "not installed: table and ablate run on this machine only; the first call with --ray installs it"
        )
        return [Finding("Ray", "note", text)]


def _lcm() -> list[Finding]:
    from tandem.processes import MULTICAST_GROUP, free_lcm_url

    mend = f"as root: ip link set lo multicast on && ip route replace {MULTICAST_GROUP}/32 dev lo"
    found = []
    route = _output("ip", "route", "get", MULTICAST_GROUP)
    interface = route.split(" dev ")[1].split()[0] if route and " dev " in route else None
    if interface == "lo":
        found.append(Finding("LCM route", "ok", f"{MULTICAST_GROUP} goes through lo: needs no network"))
    elif interface:
        text = f"{MULTICAST_GROUP} goes through {interface}: works while {interface} is up"
        text += f", messages stay on this machine (ttl 0); to be independent of it, {mend}"
        found.append(Finding("LCM route", "note", text))
    else:
        found.append(Finding("LCM route", "note", f"no route for {MULTICAST_GROUP}; {mend}"))
    url = free_lcm_url()
    try:
        milliseconds = round_trip(url)
    except Exception as error:
        return [
            *found,
            Finding("LCM", "bad", f"{url} can't be opened ({error}): the programs can't talk; {mend}"),
        ]
    if milliseconds is None:
        return [
            *found,
            Finding(
                "LCM",
                "bad",
                f"a message on {url} did not come back within 1 s: the programs can't talk; {mend}",
            ),
        ]
    return [*found, Finding("LCM", "ok", f"a message came back in {milliseconds:.2f} ms")]


def round_trip(url: str) -> float | None:
    """Milliseconds until our own message came back, None after 1 s."""
    import lcm

    link, came = lcm.LCM(url), []
    link.subscribe("TANDEM_DOCTOR", lambda channel, data: came.append(data))
    start = time.perf_counter()
    link.publish("TANDEM_DOCTOR", b"knock")
    while not came and (left := 1.0 - (time.perf_counter() - start)) > 0:
        link.handle_timeout(max(1, int(1000 * left)))
    return 1000 * (time.perf_counter() - start) if came else None


def _socket_buffers() -> list[Finding]:
    from tandem.processes import receive_buffer

    sizes = {
        name: int(Path(f"/proc/sys/net/core/{name}").read_text()) // 1024
        for name in ("rmem_default", "rmem_max")
    }
    text = f"net.core.rmem_max {sizes['rmem_max']} KiB, rmem_default {sizes['rmem_default']} KiB: "
    if receive_buffer() >= 2 << 20:
        return [Finding("socket buffers", "ok", text + "our programs ask for 2 MiB; an episode's burst fits")]
    text += "an episode's burst may be cut; it is then sent again (slower, nothing lost), camera frames are"
    text += " dropped. For 2 MiB, as root: sysctl -w net.core.rmem_max=2097152"
    return [Finding("socket buffers", "note", text)]


def _real_time() -> list[Finding]:
    import resource

    # In a process of its own: a changed scheduler would stay with us.
    probe = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))"
    fifo = _output(sys.executable, "-c", probe) is not None
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    unlimited = soft == resource.RLIM_INFINITY or os.geteuid() == 0
    limit = "unlimited" if unlimited else f"{soft // 1024} KiB"
    text = f"SCHED_FIFO {'allowed' if fifo else 'refused'}, locked memory {limit}"
    if fifo and (unlimited or soft >= 256 << 20):
        return [Finding("real time", "ok", f"{text}: --clock realtime gets its deadlines from the scheduler")]
    return [
        Finding(
            "real time",
            "note",
            f"{text}: lockstep (the default) is not touched; --clock realtime may miss deadlines."
            f" Mend: run as root, or add '{os.environ.get('USER', 'USER')} - rtprio 90' and '... - memlock"
            " unlimited' to /etc/security/limits.conf",
        )
    ]


def _cpu() -> list[Finding]:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    model = next(
        (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine()
    )
    flags = set(next((line for line in lines if line.startswith("flags")), "").split())
    wide = [name for name in ("sse4_2", "avx2", "fma", "avx512f") if name in flags]
    cores = len(os.sched_getaffinity(0))
    found = [Finding("CPU", "ok", f"{model}, {cores} cores for us, {' '.join(wide) or 'no wide vectors'}")]
    if "sse4_2" not in flags and platform.machine() == "x86_64":
        found.append(
            Finding("CPU", "bad", "the programs are built for x86-64-v2 (SSE 4.2), which this CPU lacks")
        )
    if cores < 2:
        found.append(
            Finding("cores", "note", "arm and learner share one core; training takes about twice as long")
        )
    kernels = _output(str(program("tandem_policy")), "kernels")
    if kernels:
        found.append(
            Finding(
                "policy kernels", "ok", "; ".join(" ".join(line.split()) for line in kernels.splitlines())
            )
        )
    return found


def _drawing() -> list[Finding]:
    probe = (
        "import ctypes; e = ctypes.CDLL('libEGL.so.1'); e.eglGetDisplay.restype = ctypes.c_void_p;"
        "e.eglInitialize.argtypes = [ctypes.c_void_p] * 3; d = e.eglGetDisplay(None);"
        "raise SystemExit(0 if d and e.eglInitialize(d, None, None) else 1)"
    )
    if _output(sys.executable, "-c", probe, environment={"EGL_PLATFORM": "surfaceless"}) is not None:
        return [Finding("drawing", "ok", "EGL works without a screen: videos and cameras")]
    return [
        Finding(
            "drawing",
            "note",
            "EGL does not start without a screen: training works, demo.mp4 and cameras don't."
            " On Debian, as root: apt-get install libegl-mesa0 libgl1-mesa-dri",
        ),
    ]


def _disk() -> list[Finding]:
    free = shutil.disk_usage(ROOT).free / 1e9
    text = f"{free:.1f} GB free; a training run takes about 0.2 GB"
    return [Finding("disk", "bad" if free < 0.3 else "note" if free < 3.0 else "ok", text)]


CHECKS: list[Callable[[], list[Finding]]] = [
    _programs,
    _versions,
    _ray,
    _lcm,
    _socket_buffers,
    _real_time,
    _cpu,
    _drawing,
    _disk,
]
