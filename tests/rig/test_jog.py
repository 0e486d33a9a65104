"""``rig jog``: slow, tightly limited, de-energised before and after."""

import json
import math
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import LinkError
from drivers.interfaces import ServoLimits
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.control.jog import move, plan_jog
from rig.runs.run_record import Ending
from rig.terminal.stop_button import StopButton

BENCH = load_bench("practical").value


def ignore(stage: str, cycles: int, sample: Any) -> None:
    """Show no progress."""


def silent(words: str, good: bool) -> None:
    pass


def test_it_goes_there_slowly_and_ends_without_power(fake_bench: Any) -> None:
    bench = fake_bench(joint=0.1)
    jog = plan_jog(BENCH, (10.0, -5.0), 5.0)
    outcome = move(jog, BENCH, bench.devices(), StopButton(), ignore, silent)
    assert outcome.ending is Ending.DONE
    assert outcome.safe.verified
    assert not bench.drive_state.energised
    assert bench.targets[-1] == math.radians(-5)
    assert math.radians(10) in bench.targets
    speed = np.abs(np.diff([0.1, *bench.targets])) / BENCH.cycle_s
    assert 0.9 * math.radians(5) < speed.max() <= math.radians(5) * (1 + 1e-9)
    assert bench.calls["enable"] == 1


def test_the_limits_are_low_in_host_and_drive(fake_bench, monkeypatch):
    written: list[ServoLimits] = []
    write = fake_bench.write_limits

    def noting(self: Any, limits: ServoLimits) -> None:
        written.append(limits)
        write(self, limits)

    monkeypatch.setattr(fake_bench, "write_limits", noting)
    bench = fake_bench()
    own = bench.read_limits()
    move(plan_jog(BENCH, (1.0,), 5.0), BENCH, bench.devices(), StopButton(), ignore, silent)
    assert written[0].speed_rad_s == pytest.approx(math.radians(10))
    assert written[0].torque_N_m == pytest.approx(45.0)
    assert written[0].current_A == pytest.approx(15.0)
    assert written[-1] == own


@pytest.mark.parametrize(("speed", "limit"), [(2.0, 10.0), (5.0, 10.0), (10.0, 20.0)])
def test_a_slow_jog_leaves_room_for_the_breakaway(speed: float, limit: float) -> None:
    assert plan_jog(BENCH, (1.0,), speed).limits.speed == pytest.approx(math.radians(limit))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"velocity_rad_s": 0.2}, "joint speed 0.2 rad/s"),
        ({"current_A": 15.1}, "motor current 15.1 A"),
    ],
)
def test_a_limit_trips(fake_bench: Any, change: dict[str, float], words: str) -> None:
    bench = fake_bench()
    bench.faults["exchange", 200] = lambda: bench.overrides.update(change)
    outcome = move(
        plan_jog(BENCH, (20.0,), 5.0), BENCH, bench.devices(), StopButton(), ignore, silent
    )
    assert outcome.ending is Ending.TRIPPED
    assert words in outcome.message
    assert outcome.safe.verified
    assert len(bench.targets) == 200


@pytest.mark.parametrize(("number", "cycles"), [(signal.SIGINT, 50), (signal.SIGQUIT, 0)])
def test_sigquit_takes_the_power_off_without_the_ramp(fake_bench, number, cycles):
    bench = fake_bench()
    bench.faults["exchange", 200] = lambda: signal.raise_signal(number)
    with StopButton() as stop:
        outcome = move(plan_jog(BENCH, (20.0,), 5.0), BENCH, bench.devices(), stop, ignore, silent)
    assert (outcome.ending, outcome.safe.verified) == (Ending.STOPPED, True)
    # The fake stands at the exchange numbered 250; its state is read every 5 ms.
    assert 0 <= bench.calls["exchange"] - 200 - cycles <= 5 * bool(cycles)


def test_a_bus_that_dies(fake_bench: Any) -> None:
    def gone() -> None:
        raise LinkError("bus-off")

    bench = fake_bench()
    bench.faults["exchange", 200] = gone
    outcome = move(
        plan_jog(BENCH, (20.0,), 5.0), BENCH, bench.devices(), StopButton(), ignore, silent
    )
    assert outcome.ending is Ending.FAILED
    assert "bus-off" in outcome.message
    assert not bench.drive_state.energised


@pytest.mark.parametrize(
    ("angles", "speed", "words"),
    [
        ((31.0, -40.0), 5.0, "--to 31: outside the bench's range -30 to 30 deg"),
        ((0.0,), 31.0, "--speed 31: must be above 0 and at most 30 deg/s"),
        ((float("nan"),), 5.0, "--to nan: outside"),
    ],
)
def test_what_the_bench_does_not_allow(angles: tuple[float, ...], speed: float, words: str) -> None:
    with pytest.raises(InputError) as caught:
        plan_jog(BENCH, angles, speed)
    assert words in caught.value.problems[0]
    assert len(caught.value.problems) == (2 if angles[0] == 31.0 else 1)


def test_the_command(tmp_path: Path) -> None:
    result = tmp_path / "jog.json"
    assert status(["jog", "practical", "--to", "3", "--to", "0", "--json", str(result)]) == 0
    found = json.loads(result.read_text())
    assert (found["schema"], found["state"], found["de_energised"]) == (
        "loadrig.jog/1",
        "done",
        True,
    )
    assert status(["jog", "practical", "--to", "99"]) == 2
