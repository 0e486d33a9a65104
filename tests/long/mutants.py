"""Mutation testing: every small change of a safety module must be noticed by its tests.

What lives on is printed; it is either missing from the tests or argued in :data:`ARGUED`.
"""

import argparse
import importlib
import os
import sys
from collections.abc import Mapping
from pathlib import Path

from .mutant_runner import Verdict, judge

ROOT = Path(__file__).resolve().parents[2]
TARGETS: Mapping[str, tuple[str, ...]] = {
    "rig.control.phase_handlers": ("tests/rig/test_sequencer.py",),
    "rig.wiring.teardown": ("tests/rig/test_teardown.py",),
    "rig.wiring.braking": ("tests/rig/test_braking.py",),
    "rig.wiring.runaway": ("tests/rig/test_runaway.py",),
    "rig.wiring.off": (
        "tests/rig/test_teardown.py",
        "tests/rig/test_braking.py",
        "tests/rig/test_off.py",
    ),
    "rig.control.safety": ("tests/rig/test_safety.py",),
    "rig.wiring.drive_limits": ("tests/rig/test_drive_limits.py",),
    "rig.terminal.stop_button": ("tests/rig/test_stop_button.py",),
    "rig.common.timing": ("tests/rig/test_run_samples.py",),
    "rig.control.cycle": ("tests/rig/test_cycle.py",),
    "rig.wiring.guard": ("tests/rig/test_guard.py",),
    "rig.wiring.guardian": ("tests/rig/test_guardian.py",),
    "drivers.canopen.cia402": ("tests/drivers/test_cia402.py",),
    "drivers.canopen.cia402_servo": (
        "tests/drivers/test_cia402_servo.py",
        "tests/drivers/test_eds_file.py",
        "tests/drivers/test_readings.py",
    ),
    "drivers.canopen.cia402_objects": (
        "tests/drivers/test_cia402_servo.py",
        "tests/drivers/test_lean_devices.py",
    ),
    "rig.control.motion_proof": ("tests/rig/test_motion_proof.py",),
    "drivers.transitions": (
        "tests/drivers/test_cia402_servo.py",
        "tests/drivers/test_dbc_servo.py",
    ),
    "drivers.dbc.servo": ("tests/drivers/test_dbc_servo.py", "tests/drivers/test_readings.py"),
}
"""Module to the tests that guard it."""

_READ_ON = "how much is read at a time decides nothing, as what is left is read next"
_OUTSIDE = "asked only of a value outside its limits, which cannot be equal to one of them"
_NO_SUCH_STATE = "no state has all of bits 0 to 3, 5 and 6 set, and no word looked up has bit 4"
_NOTHING_STAGED = "before a target is staged, the present and the previous one are the same"
_SIGN = "the sign is 1 or -1"
_NO_WAIT = "a time that has passed already is waited for as long as none: not at all"
ARGUED: Mapping[tuple[str, str], str] = {
    ("drivers.canopen.cia402", "_BY_BITS: 112 -> 111"): _NO_SUCH_STATE,
    ("drivers.canopen.cia402", "_BY_BITS: 112 -> 113"): _NO_SUCH_STATE,
    **{
        ("drivers.canopen.cia402_servo", f"Cia402Servo.__init__: 0 -> {other} (3)"): _NOTHING_STAGED
        for other in (1, -1)
    },
    **{
        (
            "drivers.canopen.cia402_objects",
            f"CyclicValues.sample: {value} * scales.sign -> {value} / scales.sign",
        ): _SIGN
        for value in (
            "values[at[sent.current]] * sent.current_unit_A",
            "values[at[sent.speed]] * scales.joint_speed_unit_rad_s",
            "values[at.get(sent.voltage, _NOT_SENT)] * scales.voltage_unit_V",
        )
    },
    (
        "rig.control.cycle",
        "Cycle._exchange: 0 -> -1",
    ): "the later of two times counts, and no cycle starts before its time",
    ("rig.wiring.guard", "_CHUNK: 4096 -> 4095"): _READ_ON,
    ("rig.wiring.guard", "_CHUNK: 4096 -> 4097"): _READ_ON,
    (
        "rig.wiring.guard",
        "Guard.__init__: b'' -> b'x'",
    ): "what was heard before `ready` is dropped with it",
    ("rig.wiring.guard", "Guard.feed: 0.0 -> -1.0"): _NO_WAIT,
    ("rig.wiring.guard", "Guard.feed: 0.0 -> -1.0 (2)"): _NO_WAIT,
    ("rig.wiring.guardian", "_CHUNK: 4096 -> 4095"): _READ_ON,
    ("rig.wiring.guardian", "_CHUNK: 4096 -> 4097"): _READ_ON,
    (
        "rig.wiring.drive_limits",
        "_step: 0.0 -> -1.0",
    ): "the share of the limit counts where there is no step",
    (
        "rig.wiring.drive_limits",
        "_step: float(getattr(steps, resolution)) -> without float",
    ): "for the type checker",
    (
        "rig.control.safety",
        "check: angle < limits.angle_min -> angle <= limits.angle_min",
    ): _OUTSIDE,
    (
        "rig.control.safety",
        "check: supply < limits.supply_min -> supply <= limits.supply_min",
    ): _OUTSIDE,
}
"""Living mutants that change nothing: (module, words) to why."""

_WARM = ("numpy", "psutil", "yaml", "pydantic", "can", "canopen", "serial", "numba", "mcap")
"""Imported before the first fork, so that every child starts warm."""


def told(name: str, verdict: Verdict, whole: bool) -> int:
    """Print what came of a module; returns how much of it is to be mended."""
    if verdict.trouble:
        print(f"{name}: {verdict.trouble}")
        return 1
    living = {words for _, words in verdict.living}
    argued = {words for module, words in ARGUED if module == name}
    unargued = [mutant for mutant in verdict.living if mutant[1] not in argued]
    print(
        f"{name}: {verdict.total} mutants, {verdict.total - len(living)} killed ({verdict.slow} "
        f"by the time limit), "
        f"{len(living & argued)} argued, {len(unargued)} alive; {verdict.seconds:.0f} s",
        flush=True,
    )
    for line, words in unargued:
        print(f"  line {line}: {words}")
    dead = sorted(argued - living) if whole else []
    for words in dead:
        print(f"  argued, and not alive: {words}")
    return len(unargued) + len(dead)


def main() -> int:
    """Test every mutant of every target, and print those that live."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", nargs="*", help=f"of {', '.join(TARGETS)}; all by default")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", default="", help="only mutants whose words contain this")
    parser.add_argument(
        "--coverage", action="store_true", help="print what to tell pytest-cov instead"
    )
    options = parser.parse_args()
    if options.coverage:
        print(
            *(f"--cov={name}" for name in TARGETS),
            *dict.fromkeys(test for tests in TARGETS.values() for test in tests),
        )
        return 0
    os.chdir(ROOT)
    for warm in _WARM:
        importlib.import_module(warm)
    unargued = 0
    for name in options.modules or TARGETS:
        verdict = judge(name, TARGETS[name], ROOT, options.jobs, options.only)
        unargued += told(name, verdict, not options.only)
    return 1 if unargued else 0


if __name__ == "__main__":
    sys.exit(main())
