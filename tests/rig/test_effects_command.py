"""``rig effects`` as a user runs it."""

import json
from pathlib import Path

import pytest

from identification.effects import EFFECTS
from rig.cli.entry import status


def test_every_effect_has_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["effects"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [
        line.removeprefix(e.group).split()[0]
        for line, e in zip(lines[2:], EFFECTS.values(), strict=True)
    ] == list(EFFECTS)
    assert max(map(len, lines)) <= 130


def test_the_record_holds_what_is_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "effects.json"
    assert status(["effects", "--json", str(file)]) == 0
    record = json.loads(file.read_text())
    assert record["schema"] == "loadrig.effects/1"
    assert [e["name"] for e in record["effects"]] == list(EFFECTS)
    assert all(e["parameters"] and e["separating_experiment"] for e in record["effects"])
    assert capsys.readouterr().out


def test_a_misspelt_name_gets_a_suggestion(capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["effects", "backlsh"]) == 2
    assert "did you mean 'backlash'?" in capsys.readouterr().err
