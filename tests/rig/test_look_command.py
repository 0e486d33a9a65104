"""``rig look``: what is in a log, and a first campaign file."""

import json
from pathlib import Path

import numpy as np
import pytest

from rig.cli.entry import status
from rig.config.campaign import load_campaign
from rig.sources import load_source

N = 400
TIME = np.arange(N) * 2e-3
ANGLE = 0.3 * np.sin(8.0 * TIME)


def write_log(path: Path, header: str = "time_ms,i [mA],phi_m,pos [deg],text") -> None:
    step = 2.0 * np.pi / 4096
    counts = np.rint(100 * ANGLE / step) % 2**16
    counts[350:] = counts[350] + np.arange(50) % 2
    time = TIME * 1e3
    time[300:] += 50.0
    rows = zip(time, 2000 * np.cos(8 * TIME), counts, np.degrees(ANGLE), strict=True)
    lines = [",".join([*(repr(float(v)) for v in row), "on"]) for row in rows]
    path.write_text("\n".join([header, *lines]), encoding="utf-8")


def test_a_look_finds_units_rate_gap_wrap_and_text(tmp_path, capsys):
    write_log(tmp_path / "log.csv")
    arguments = ["look", str(tmp_path / "log.csv"), "--json", str(tmp_path / "look.json")]
    assert status(arguments) in (None, 0)
    out = capsys.readouterr().out
    assert "500 Hz (median period 0.002 s)" in out
    assert "1 gaps, the longest step 0.052 s" in out
    assert "█" in out
    record = json.loads((tmp_path / "look.json").read_text())
    assert record["schema"] == "loadrig.look/1"
    (log,) = record["logs"]
    time, current, motor, angle, text = log["columns"]
    assert (time["channel"], time["scale"]) == ("time", 1e-3)
    assert (current["channel"], current["unit"], current["scale"]) == ("current", "ma", 1e-3)
    assert motor["channel"] == "motor_angle"
    assert motor["step"] == 1.0
    assert motor["flicker"] > 0.02
    assert "a counter of 16 bits" in motor["wrap"]
    assert angle["scale"] == pytest.approx(np.pi / 180)
    assert "is not a number (got 'on')" in text["problem"]
    assert len(current["course"]) == 40
    assert log["clock"]["period_s"] == pytest.approx(2e-3)


def test_the_record_of_a_look_is_json_for_every_reader(tmp_path):
    write_log(tmp_path / "log.csv")
    record = tmp_path / "look.json"
    assert status(["look", str(tmp_path / "log.csv"), "--json", str(record)]) in (None, 0)

    def refuse(word: str) -> None:
        raise AssertionError(word)

    json.loads(record.read_text(), parse_constant=refuse)


def test_a_column_without_rows_is_shown(tmp_path, capsys):
    np.savez(tmp_path / "empty.npz", t=np.empty(0), q=np.empty(0))
    assert status(["look", str(tmp_path / "empty.npz")]) == 0
    assert "0 rows" in capsys.readouterr().out


def test_a_linear_bench_has_its_own_units(tmp_path, capsys):
    rows = "\n".join(f"{0.001 * k},{k % 7},{k % 5}" for k in range(400))
    (tmp_path / "log.csv").write_text(f"t,pos [mm],force_kN\n{rows}\n")
    campaign = tmp_path / "c.yaml"
    assert status(["look", str(tmp_path / "log.csv"), "--campaign", str(campaign)]) in (None, 0)
    text = campaign.read_text()
    assert "angle: " in text
    assert "torque: " in text


def test_the_campaign_of_a_look_is_valid_and_loads(tmp_path, capsys):
    write_log(tmp_path / "log_5kg.csv", "time_ms;i [mA];phi_m;pos [deg];text")
    text = (tmp_path / "log_5kg.csv").read_text().replace(",", ";").replace(".", ",")
    (tmp_path / "log_5kg.csv").write_text("made by a logger\n" + text)
    campaign = tmp_path / "c.yaml"
    arguments = ["look", str(tmp_path / "log_5kg.csv"), "--skip-rows", "1", "--decimal", ","]
    assert status([*arguments, "--campaign", str(campaign)]) in (None, 0)
    assert "set the bench's constants" in capsys.readouterr().out
    section = load_campaign(campaign).value.recordings[0]
    assert section.read.decimal == ","
    assert section.weight_mass == 5.0
    np.testing.assert_allclose(
        load_source(campaign).recordings[0].channels["angle"][:300], ANGLE[:300], atol=1e-12
    )
    assert status([*arguments, "--campaign", str(campaign)]) == 2


def test_an_angle_that_starts_again_is_noted_and_its_turn_is_written(tmp_path):
    angle = 900.0 * np.sin(4.0 * TIME)
    rows = zip(TIME, 2.0 * np.cos(4.0 * TIME), angle % 360.0, strict=True)
    lines = [",".join(repr(float(value)) for value in row) for row in rows]
    (tmp_path / "log.csv").write_text("\n".join(["time [s],current [A],angle [deg]", *lines]))
    campaign = tmp_path / "c.yaml"
    arguments = ["look", str(tmp_path / "log.csv"), "--json", str(tmp_path / "look.json")]
    assert status([*arguments, "--campaign", str(campaign)]) in (None, 0)
    (log,) = json.loads((tmp_path / "look.json").read_text())["logs"]
    note = log["columns"][2]["wrap"]
    assert "360" in note
    assert "wraps_after" in note
    channels = load_campaign(campaign).value.recordings[0].channels
    turns = {name: channel.wraps_after for name, channel in channels.items()}
    assert turns == {"time": None, "current": None, "angle": 360.0}
    found = load_source(campaign).recordings[0].channels["angle"]
    np.testing.assert_allclose(found - found[0], np.radians(angle), atol=1e-9)


def test_a_log_whose_columns_are_unknown_names_the_remedy(tmp_path, capsys):
    write_log(tmp_path / "log.csv", "a,b,c,d,e")
    arguments = ["look", str(tmp_path / "log.csv"), "--campaign", str(tmp_path / "c.yaml")]
    assert status(arguments) == 2
    captured = capsys.readouterr()
    assert "no column is recognised as time" in captured.out
    assert "rig new campaign" in captured.err
    assert not (tmp_path / "c.yaml").exists()


def test_a_look_at_a_campaign_and_at_nothing(tmp_path, capsys):
    write_log(tmp_path / "log.csv")
    campaign = tmp_path / "c.yaml"
    assert status(["look", str(tmp_path / "log.csv"), "--campaign", str(campaign)]) in (None, 0)
    assert status(["look", str(campaign)]) in (None, 0)
    assert "log[1]: recording" in capsys.readouterr().out
    assert status(["look", str(tmp_path / "log.csv"), "--delimiter", ";;"]) == 2
    (tmp_path / "log.xyz").write_text("1")
    assert status(["look", str(tmp_path / "log.xyz")]) == 2
    assert "unknown format; readable are csv" in capsys.readouterr().err
