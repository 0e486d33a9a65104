from pathlib import Path

import pytest

from rig.common.errors import InputError
from rig.config.campaign import load_campaign

CONTRACT = """\
campaign: 1
bench:
  motion: rotary
  torque_constant: 0.03
  back_emf_constant: 0.02588
  resistance: 1.56
  inductance: 0.00132
  gear_ratio: 100
  moment_arm: 0.095
  lever_ratio: 10
model:
  terms: []
  fixed: {J: 0.204}
recordings:
  - file: unloaded_a.csv
    stage: unloaded
    weight_mass: 0.0
    gravity: null
    role: fit
    rate: 1000
    read: {delimiter: ";", skip_rows: 14}
    channels:
      current: {column: i_meas, scale: 0.001, average: true}
      angle: {column: pos, scale: 0.017453292519943295}
"""

SHORT = """\
campaign: 1
bench: {torque_constant: 0.03, moment_arm: 0.095, lever_ratio: 10}
recordings:
  - file: a.csv
    channels: {time: 0, current: 1, angle: 2}
"""


def problems(folder: Path, text: str) -> list[str]:
    path = folder / "c.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_campaign(path)
    return [line.removeprefix(f"{path}:") for line in caught.value.problems]


def test_the_example_of_the_contract(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(CONTRACT)
    campaign = load_campaign(tmp_path / "c.yaml").value
    bench = campaign.bench.bench()
    assert (bench.gear_ratio, bench.moment_arm, bench.gravity) == (100.0, 0.095, 9.80665)
    assert campaign.model.model().fixed == {"J": 0.204}
    (recording,) = campaign.recordings
    assert recording.read.skip_rows == 14
    current = recording.channels["current"]
    assert (current.column, current.scale, current.offset, current.average) == (
        "i_meas",
        0.001,
        0.0,
        True,
    )


def test_defaults_reach_every_recording_and_yield_to_it(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(
        "campaign: 1\n"
        "bench: {torque_constant: 1, moment_arm: 0.1}\n"
        "defaults:\n"
        "  gravity: {zero: 0.5}\n"
        "  channels: {time: t, angle: {column: a, scale: 2}, torque: m}\n"
        "recordings:\n"
        "  - {file: a.csv, gravity: {mass: 1, length: 0.2}}\n"
        "  - {file: b.csv, gravity: null, channels: {angle: {scale: 3}, torque: n}}\n"
    )
    first, second = load_campaign(tmp_path / "c.yaml").value.recordings
    assert (first.gravity.mass, first.gravity.zero) == (1.0, 0.5)
    assert first.channels["angle"].scale == 2
    assert second.gravity is None
    assert (second.channels["angle"].column, second.channels["angle"].scale) == ("a", 3.0)
    assert second.channels["torque"].column == "n"
    assert second.channels["time"].column == "t"


def test_an_error_in_the_defaults_is_reported_once_where_it_stands(tmp_path: Path) -> None:
    lines = problems(
        tmp_path,
        "campaign: 1\n"
        "bench: {torque_constant: 1}\n"
        "defaults:\n"
        "  channels: {time: t, anlge: a, torque: m}\n"
        "recordings: [{file: a.csv}, {file: b.csv}]\n",
    )
    assert lines == ["4:23: recordings[0].channels.anlge: unknown channel; did you mean 'angle'?"]


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        (
            "terms: [coging]",
            "17: model.terms[0]: unknown effect; did you mean 'cogging'? (got \"coging\")",
        ),
        ("terms: [gravity_imbalance]", "a known weight is declared by `gravity:` of a recording"),
        (
            "friction: load_dependent",
            "grows with the torque of a pendulum, but no recording with role fit has `gravity`",
        ),
        (
            "friction: coulomb_viscous, fixed: {Ms: 1}",
            "model.fixed.Ms: the friction model coulomb_viscous has no static friction",
        ),
        ("fixed: {mu_C: 1}", "unknown parameter; did you mean 'mu_c'"),
        ("fixed: {J: -1}", "model.fixed: a fixed value must not be negative: J = -1"),
        (
            "fixed: {Mc: 2, Ms: 1}",
            "model.fixed.Ms: static friction Ms must be at least Coulomb friction Mc = 2 (got 1)",
        ),
    ],
)
def test_model_section(tmp_path: Path, model: str, expected: str) -> None:
    (line,) = problems(tmp_path, f"{SHORT}model: {{{model}}}\n")
    assert line.startswith("6:")
    assert expected in line


FILE = "file: a.csv"
LOADED = f"{FILE}\n    stage: loaded\n    weight_mass: 30.6"
LINEAR = "bench: {motion: linear, "


@pytest.mark.parametrize(
    ("old", "new", "place", "expected"),
    [
        ("time: 0, ", "", "5:15: recordings[0].channels: ", "no `time` channel and no `rate`"),
        (FILE, f"{FILE}\n    rate: 100", "5:11: recordings[0].rate: ", "without time"),
        ("angle: 2", "command: 2", "", "no `angle`, `velocity` or `motor_angle`"),
        ("current: 1", "command: 1", "", "no `torque`, `current` or `voltage`"),
        (
            "current: 1",
            "voltage: 1",
            "",
            "state bench.resistance and bench.back_emf_constant (got 1)",
        ),
        (FILE, f"{FILE}\n    stage: loaded", "5:12: recordings[0].stage: ", "`load_force`"),
        (FILE, f"{FILE}\n    weight_mass: 30.6", "5:18: ", "the stage is unloaded, but"),
        (FILE, f"{FILE}\n    role: validate", "", "at least one must have role fit"),
        ("campaign: 1", "campaign: 2", "1:11: campaign: ", "input should be 1 (got 2)"),
        ("angle: 2", "angle: {column: 2, scale: 0}", "", "scale is 0"),
        ("0.095,", "0.095, gear_ratio: 1e300,", "", "plausible range 1e-9 to 1e9"),
        (FILE, f"{FILE}\n    read: {{delimiter: ',', decimal: ','}}", "", "are both a comma"),
        (f"{FILE}\n", f"{FILE}\n    gravity: {{mass: 1, length: 1}}\n", None, ""),
        (FILE, LOADED, None, ""),
        ("bench: {", LINEAR, None, ""),
    ],
)
def test_cross_checks(tmp_path: Path, old: str, new: str, place: str | None, expected: str) -> None:
    text = SHORT.replace(old, new)
    assert text != SHORT
    if place is None:
        (tmp_path / "c.yaml").write_text(text)
        assert load_campaign(tmp_path / "c.yaml").value.recordings
    else:
        found = [line for line in problems(tmp_path, text) if expected in line]
        assert found
        assert found[0].startswith(place)


@pytest.mark.parametrize(
    ("more", "old", "new", "expected"),
    [
        (LOADED, ", moment_arm: 0.095", "", "5:12: recordings[0].stage: "),
        (f"{FILE}\n    gravity: {{mass: 1, length: 1}}", "bench: {", LINEAR, "5:14: "),
    ],
)
def test_loads_that_the_bench_does_not_fit(tmp_path, more, old, new, expected):
    (line,) = problems(tmp_path, SHORT.replace(FILE, more).replace(old, new))
    assert line.startswith(expected)


def test_a_weight_needs_the_lever_ratio_and_its_absence_does_not(tmp_path: Path) -> None:
    bare = SHORT.replace(", lever_ratio: 10", "")
    (tmp_path / "c.yaml").write_text(bare)
    assert load_campaign(tmp_path / "c.yaml").value.bench.lever_ratio is None
    loaded = bare.replace("file: a.csv", "file: a.csv\n    stage: loaded\n    weight_mass: 5")
    (line,) = problems(tmp_path, loaded)
    assert line.startswith(
        "6:18: recordings[0].weight_mass: a weight on the lever needs bench.lever_ratio"
    )


def test_a_loaded_recording_is_not_scored_without_working_load(tmp_path: Path) -> None:
    channels = "channels: {time: 0, current: 1, angle: 2}"
    validate = f"  - {{file: b.csv, stage: loaded, weight_mass: 30, role: validate, {channels}}}\n"
    (line,) = problems(tmp_path, SHORT + validate)
    assert "recordings[1].role: a loaded recording has role validate, but no loaded" in line
    assert line.endswith('fix mu_c, mu_s, omega_sL, mu_2 (got "validate")')
    known = "model: {fixed: {mu_c: 0.1, mu_s: 0.2, omega_sL: 0.1, mu_2: 0.1}}\n"
    (tmp_path / "c.yaml").write_text(SHORT + validate + known)
    assert len(load_campaign(tmp_path / "c.yaml").value.recordings) == 2
    (tmp_path / "c.yaml").write_text(SHORT + validate + validate.replace("validate", "fit"))
    assert len(load_campaign(tmp_path / "c.yaml").value.recordings) == 3


def test_torque_and_amperes_do_not_mix(tmp_path: Path) -> None:
    text = (
        "campaign: 1\nbench: {}\nrecordings:\n"
        "  - {file: a.csv, channels: {time: 0, current: 1, angle: 2}}\n"
        "  - {file: b.csv, channels: {time: 0, torque: 1, angle: 2}}\n"
    )
    (line,) = problems(tmp_path, text)
    assert "some recordings contain torque and others only current" in line
