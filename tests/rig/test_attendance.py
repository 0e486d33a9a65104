"""Weights of a real bench are hung while somebody is asked; anything else is refused before it
moves.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from rig.cli.entry import BAD_INPUT, status
from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.config.sequence import load_sequence
from rig.control.attendance import kept_awake, require_attendance
from rig.planning.plan import Plan, make_plan
from rig.wiring.connect import DRIVE_EDS, ENCODER_EDS

from .benches import variant

EMPTY = """\
sequence: 1
name: one
stages:
  - {name: empty, stage: unloaded, tones: [{amplitude_deg: 5, frequency_Hz: 2}], duration_s: 3}
"""
HEAVY = EMPTY + (
    "  - {name: heavy, stage: loaded, weight_kg: 5, duration_s: 3,\n"
    "     tones: [{amplitude_deg: 5, frequency_Hz: 2}]}\n"
)
REAL = ("interface: mock", "interface: virtual")


def planned(folder: Path, text: str) -> Plan:
    path = folder / "sequence.yaml"
    path.write_text(text)
    return make_plan(load_sequence(path), load_bench("practical"))


@pytest.mark.parametrize(("yes", "terminal"), [(True, True), (True, False), (False, False)])
def test_weights_and_nobody_to_ask_on_a_real_bench_are_refused(
    tmp_path: Path, yes: bool, terminal: bool
) -> None:
    bench = load_bench(variant(tmp_path, REAL))
    reason = "--yes would answer" if yes else "no terminal for the prompts"
    with pytest.raises(InputError, match=rf"{reason}.* stages heavy have weights.*without --yes"):
        require_attendance(planned(tmp_path, HEAVY), bench, yes, terminal)


def test_who_can_be_asked_or_needs_no_asking_may_run(tmp_path: Path) -> None:
    heavy, empty = planned(tmp_path, HEAVY), planned(tmp_path, EMPTY)
    real = load_bench(variant(tmp_path, REAL))
    require_attendance(heavy, real, yes=False, terminal=True)
    require_attendance(empty, real, yes=True, terminal=False)
    require_attendance(heavy, load_bench("practical"), yes=True, terminal=False)
    hoist = variant(tmp_path, REAL, ("\nbus:", "\nweights_hung_by: hoist\nbus:"))
    require_attendance(heavy, load_bench(hoist), yes=True, terminal=False)


def test_weights_and_yes_on_a_real_bench_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    planned(tmp_path, HEAVY)
    servo = ("\nservo: {", f"\nservo: {{eds: {DRIVE_EDS}, ")
    encoder = ("\nencoder: {", f"\nencoder: {{eds: {ENCODER_EDS}, ")
    bench, out = variant(tmp_path, REAL, servo, encoder), tmp_path / "run"
    sequence = str(tmp_path / "sequence.yaml")
    arguments = ["run", sequence, "--bench", str(bench), "--yes", "--out", str(out)]
    assert status(arguments) == BAD_INPUT
    assert "--yes would answer the weight prompts" in capsys.readouterr().err
    assert not out.exists()


INHIBIT = """#!/bin/sh
[ -z "$REFUSED" ] || exit 1
while [ "${1#--}" != "$1" ]; do shift; done
exec "$@"
"""


@pytest.mark.parametrize(
    ("installed", "refused", "why"),
    [
        (True, "", ""),
        (True, "1", "systemd-inhibit is refused"),
        (False, "", "systemd-inhibit is not installed"),
    ],
)
def test_the_computer_is_kept_awake_where_the_system_permits_it(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    installed: bool,
    refused: str,
    why: str,
) -> None:
    if installed:
        tool = tmp_path / "systemd-inhibit"
        tool.write_text(INHIBIT)
        tool.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin" if installed else str(tmp_path))
    monkeypatch.setenv("REFUSED", refused)
    with kept_awake("rig run") as reason:
        assert reason == why
