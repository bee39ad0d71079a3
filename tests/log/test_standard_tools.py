"""LCM's own programs read, play and record our channels; what they write, we read."""

from __future__ import annotations

import subprocess
import time
from collections import Counter
from pathlib import Path

import lcm
import numpy as np
import pytest

from tandem import processes
from tandem.log import EventLog, raw_events
from tandem.log.edit import cut
from tandem.log.spy_jar import build, lcm_jars, lcm_program, missing
from tandem.run_folder import RunFolderError
from tandem.wire import CHANNELS

PROBE = """
public class Probe {
  public static void main(String[] names) throws Exception {
    lcm.spy.LCMTypeDatabase types = new lcm.spy.LCMTypeDatabase();
    for (String name : names) {
      long fingerprint = Class.forName("tandem." + name).getField("LCM_FINGERPRINT").getLong(null);
      System.out.println("PROBE " + fingerprint + " " + types.getClassByFingerprint(fingerprint).getName());
    }
  }
}
"""


def test_lcm_logfilter_takes_our_channels_out_of_a_log(real_log: Path, tmp_path: Path) -> None:
    out = tmp_path / "filtered.lcm"
    subprocess.run([lcm_program("lcm-logfilter"), "-c", "EPISODE_.*", str(real_log), str(out)], check=True)
    wanted = frozenset({"EPISODE_STEP", "EPISODE_END"})
    ours = [(e.timestamp, e.channel, e.data) for e in raw_events(real_log, wanted)]
    assert [(e.timestamp, e.channel, e.data) for e in raw_events(out)] == ours
    assert EventLog(out).episodes.number.tolist() == [0, 1]


def _until_it_has(logger: subprocess.Popen[bytes], network: lcm.LCM, file: Path, channel: str) -> None:
    """Publishes on a channel until the recorder has written it, and with it all that came before."""
    deadline = time.monotonic() + 60.0
    while not file.exists() or channel.encode() not in file.read_bytes():
        assert time.monotonic() < deadline and logger.poll() is None
        network.publish(channel, b"")
        time.sleep(0.05)


def test_what_lcm_logplayer_plays_and_lcm_logger_records_is_the_log(real_log: Path, tmp_path: Path) -> None:
    # lcm-logger queues 30 messages and drops what comes then; so few that no load of the machine makes it
    log, few = EventLog(real_log), tmp_path / "few.lcm"
    rows = np.sort(np.concatenate([log.index.rows(channel)[:3] for channel in log.index.channels]))
    assert cut(log, rows, few) <= 25
    recorded, url = tmp_path / "recorded.lcm", processes.free_lcm_url()
    logger = subprocess.Popen([lcm_program("lcm-logger"), "-q", "-l", url, str(recorded)])
    try:
        network = lcm.LCM(url)
        _until_it_has(logger, network, recorded, "BEGIN")
        subprocess.run(
            [lcm_program("lcm-logplayer"), "--speed=10", f"--lcm-url={url}", str(few)],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        _until_it_has(logger, network, recorded, "FINISHED")
    finally:
        logger.terminate()
        logger.wait(10.0)
    sent = Counter((e.channel, e.data) for e in raw_events(few))
    heard = Counter(
        (e.channel, e.data) for e in raw_events(recorded) if e.channel not in ("BEGIN", "FINISHED")
    )
    assert heard == sent


def test_lcm_spy_finds_every_type_in_the_jar_when_there_is_java(tmp_path: Path) -> None:
    if sentence := missing():
        with pytest.raises(RunFolderError, match="default-jdk-headless"):
            build(tmp_path / "types.jar")
        assert "not found" in sentence
        return
    jar = build(tmp_path / "types.jar")
    (tmp_path / "Probe.java").write_text(PROBE)
    classpath = ":".join(map(str, [jar, *lcm_jars()]))
    names = [message_type.__name__ for message_type in CHANNELS.values()]
    found = subprocess.run(
        [
            "java",
            "-XX:TieredStopAtLevel=1",
            "-Djava.awt.headless=true",
            "-cp",
            classpath,
            str(tmp_path / "Probe.java"),
            *names,
        ],
        env={"PATH": "/usr/bin:/bin", "CLASSPATH": classpath},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    told = dict(line.split()[1:] for line in found.splitlines() if line.startswith("PROBE"))
    for message_type in CHANNELS.values():
        packed = message_type._get_packed_fingerprint()  # type: ignore[attr-defined]
        assert told[str(int.from_bytes(packed, "big", signed=True))] == f"tandem.{message_type.__name__}"


def test_without_java_a_sentence_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sentence = missing(str(tmp_path))
    assert sentence is not None and "java, javac, jar not found" in sentence
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(RunFolderError, match="default-jdk-headless"):
        build(tmp_path / "types.jar")
