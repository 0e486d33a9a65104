"""Ctrl-C on a real process in every phase of a run."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from rig.runs.mcap.reader import read_run
from rig.runs.run import read_record

from .benches import sine, stages

CHILD = """
import dataclasses
import sys
import rig.planning.plan
import rig.control.sequencer
from drivers.canopen.cia402_servo import Cia402Servo
from rig.cli.entry import status
from rig.control.cycle import Cycle

next_phase = rig.control.sequencer.next_phase
follow, quick_stop = Cycle.follow, Cia402Servo.quick_stop

def announce(phase, event):
    following = next_phase(phase, event)
    print("phase", following.value, flush=True)
    return following

def count(self, targets, segment, *rest):
    self._progress = lambda stage, cycles, sample: print("cycles", segment, flush=True)
    follow(self, targets, segment, *rest)

def brake(self, **keys):
    quick_stop(self, **keys)
    print("braking", flush=True)
    sys.stdin.readline()

limits = rig.planning.plan._limits
# A busy machine is late; the signals are on trial here.
def patient(values, bench):
    return dataclasses.replace(limits(values, bench), lateness=30.0)

rig.planning.plan._limits = patient
rig.control.sequencer.next_phase, Cycle.follow = announce, count
if sys.argv.pop(1) == "hold":
    Cia402Servo.quick_stop = brake
sys.exit(status(sys.argv[1:]))
"""
SEQUENCE = stages(
    sine("empty", 0.5, 0.5, 60.2, more=", ramp_in_s: 0.1, settle_s: 0"),
    head="limits: {speed_deg_s: 20}\n",
)


@contextmanager
def running(tmp_path: Path, *options: str, hold: bool = False) -> Iterator[subprocess.Popen[str]]:
    sequence = tmp_path / "long.yaml"
    sequence.write_text(SEQUENCE)
    command = ["run", str(sequence), "--realtime", "--out", str(tmp_path / "out"), *options]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    arguments = [sys.executable, "-c", CHILD, "hold" if hold else "free", *command]
    with subprocess.Popen(arguments, text=True, **pipes) as child:  # type: ignore[call-overload]
        try:
            yield child
        finally:
            child.kill()


def wait_for(child: subprocess.Popen[str], words: str, times: int = 1) -> None:
    said = ""
    while said.count(words) < times:
        character = child.stdout.read(1)
        assert character, f"the run ended before {words!r}: {said}"
        said += character


def assert_stopped(child: subprocess.Popen[str], tmp_path: Path, words: str) -> None:
    said, _ = child.communicate(timeout=30)
    assert child.returncode == 3, said
    assert "Traceback" not in said
    record = read_record(tmp_path / "out")
    assert (record.state, record.de_energised) == ("stopped", True)
    assert words in record.message
    log = read_run(tmp_path / "out/recording.mcap")
    assert log.damage is None
    assert log.events[-1]["event"] == "stopped"


def test_in_motion(tmp_path: Path) -> None:
    with running(tmp_path, "--yes") as child:
        wait_for(child, "cycles 1\n", times=2)
        child.send_signal(signal.SIGTERM)
        assert_stopped(child, tmp_path, "phase excite: stopped by the operator")
    segment = read_run(tmp_path / "out/recording.mcap").samples["segment"]
    # The recording goes on while the drive brakes.
    assert segment[-1] == 0
    assert np.count_nonzero(segment) >= 200


def test_a_second_one_while_braking_takes_the_power_off_at_once(tmp_path: Path) -> None:
    with running(tmp_path, "--yes", hold=True) as child:
        wait_for(child, "cycles 1\n")
        child.send_signal(signal.SIGINT)
        wait_for(child, "braking")
        child.send_signal(signal.SIGINT)
        child.stdin.write("\n")
        child.stdin.flush()
        assert_stopped(child, tmp_path, "phase excite: stopped by the operator")
    samples = read_run(tmp_path / "out/recording.mcap").samples
    # The ramp was cut short: nothing was recorded after the second one, and the drive is verified
    # off.
    assert samples["segment"][-1] == 1


def test_one_more_after_the_end_leaves_the_status_of_a_stopped_run() -> None:
    script = (
        "import os, signal\n"
        "from rig.cli import entry\n"
        "entry.status = lambda arguments: entry.STOPPED\n"
        "entry.gc.freeze = lambda: [os.kill(os.getpid(), n) for n in (SIGNALS)]\n"
        "entry.main()\n"
    ).replace("SIGNALS", "signal.SIGINT, signal.SIGTERM, signal.SIGTSTP")
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, timeout=60)
    assert (ended.returncode, ended.stderr) == (3, b"")
