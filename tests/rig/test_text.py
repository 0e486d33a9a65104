"""Text of every language in every locale; files arrive whole or not at all."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import rig as rig_package
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.common.places import replacing, require_file, require_folder, write_json, write_text
from rig.common.text import stored_path, valid
from rig.runs.mcap.reader import read_run
from rig.runs.run import read_record

from .command import assert_in_words, rig

LOCALE = {
    **{"LC_ALL": "POSIX", "PYTHONIOENCODING": "ascii"},
    **{"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
}
WHO = "Jürgen ☃"


def test_names_of_every_language_go_through_a_run(short_sequence: Path, tmp_path: Path) -> None:
    """The run stops at its prompt, and goes on."""
    place = tmp_path / WHO
    place.mkdir()
    sequence = f"# µ °\n{short_sequence.read_text()}"
    (place / "kurz µ.yaml").write_text(sequence, encoding="utf-8")
    run = ["run", f"{WHO}/kurz µ.yaml", "--operator", WHO, "--out", f"{WHO}/Lauf"]
    go_on = ["resume", f"{WHO}/Lauf", "--yes", "--json", f"{WHO}/µ.json"]
    export = ["export", f"{WHO}/Lauf", "--out", f"{WHO}/ü.csv"]
    for arguments, code in ((run, 3), (go_on, 0), (export, 0)):
        ended = rig(*arguments, folder=tmp_path, environment=LOCALE)
        assert_in_words(ended)
        assert ended.returncode == code, ended.stderr
        assert "?" not in ended.stdout
    record = read_record(place / "Lauf")
    assert record.operator == WHO
    assert record.inputs["sequence.yaml"]["file"] == str(place / "kurz µ.yaml")
    assert read_run(place / "Lauf" / "recording.mcap").metadata["run"]["operator"] == WHO
    for file in place.rglob("*.json"):
        # As strict readers take it, which refuse half characters.
        json.loads(file.read_text(encoding="utf-8")).__repr__().encode("utf-8")
    assert WHO in (place / "Lauf" / "run.html").read_text(encoding="utf-8")


def test_an_argument_that_is_no_utf_8_is_kept_readable(short_sequence: Path) -> None:
    out = short_sequence.with_name("out")
    arguments = ["run", str(short_sequence), "--yes", "--operator", "J\udcfcrgen"]
    assert status([*arguments, "--out", str(out)]) == 0
    assert read_record(out).operator == "J\\xfcrgen"


def test_bytes_that_were_not_decoded_are_read_as_utf_8() -> None:
    assert valid(WHO.encode("utf-8").decode("ascii", "surrogateescape")) == WHO
    assert valid("J\udcfcrgen") == "J\\xfcrgen"
    assert valid("half \ud83d") == "half ?"
    assert valid(WHO) == WHO


@given(st.text(st.characters(exclude_categories=())))
def test_valid_text_is_utf_8_and_stays_as_it_is(text: str) -> None:
    found = valid(text)
    found.encode("utf-8")
    assert valid(found) == found
    if not any("\ud800" <= character <= "\udfff" for character in text):
        assert found == text


def test_files_are_written_as_utf_8(tmp_path: Path) -> None:
    write_text(tmp_path / "page.html", "\udcc3\udcbc µ")
    assert (tmp_path / "page.html").read_bytes() == "ü µ".encode()
    write_json(
        tmp_path / "record.json", {"file": "\udcc3\udcbc", "emoji": "😀", "escape": "\\udcc3"}
    )
    content = (tmp_path / "record.json").read_bytes()
    assert b"\\udc" not in content.replace(b"\\\\udcc3", b"").replace(b"\\ud83d\\ude00", b"")
    assert json.loads(content) == {"file": "ü", "emoji": "😀", "escape": "\\udcc3"}


def test_a_stored_path_leads_back_to_the_file(tmp_path, monkeypatch):
    file = tmp_path / WHO
    file.write_bytes(b"")
    assert stored_path(str(file)) == file
    if sys.platform == "linux":
        # As in a C locale.
        monkeypatch.setattr(os, "fsencode", lambda name: name.encode("ascii", "surrogateescape"))
        monkeypatch.setattr(os, "fsdecode", lambda name: name.decode("ascii", "surrogateescape"))
        assert str(stored_path(str(file))) == str(file).encode().decode("ascii", "surrogateescape")


def test_every_text_file_is_opened_with_its_encoding() -> None:
    """The default is that of the locale."""
    rule = ["ruff", "check", "--isolated", "--no-cache", "--preview", "--select", "PLW1514"]
    packages = ["rig", "drivers", "identification"]
    root = Path(rig_package.__file__).parents[1]
    done = subprocess.run([sys.executable, "-m", *rule, *packages], cwd=root, capture_output=True)
    assert done.returncode == 0, done.stdout


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    write_json(path, {"a": 1})
    write_json(path, {"a": 2})
    assert json.loads(path.read_text()) == {"a": 2}
    assert names(tmp_path) == ["r.json"]


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt()])
def test_the_earlier_version_survives_and_no_draft_is_left(tmp_path, error):
    path = tmp_path / "r.txt"
    write_text(path, "before")

    def spoil() -> None:
        with replacing(path) as draft:
            draft.write_text("hal")
            raise error

    with pytest.raises(type(error)):
        spoil()
    assert path.read_text() == "before"
    assert names(tmp_path) == ["r.txt"]


def test_a_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "data" / "target")
    write_text(tmp_path / "link", "x")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "data" / "target").read_text() == "x"


def test_places_that_will_not(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    with pytest.raises(
        InputError,
        match=r"inside/deep: cannot be created, because .*taken is a file; give --out another",
    ):
        require_folder(tmp_path / "taken" / "inside" / "deep", "--out")
    with pytest.raises(
        InputError, match=r"the folder .*missing does not exist; create the folder, or give"
    ):
        require_file(tmp_path / "missing" / "r.json", "--json")
    with pytest.raises(InputError, match=r"is a folder; give --json a file"):
        require_file(tmp_path, "--json")


def test_places_that_may_not_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Permissions do not bind every user that tests run as, so the answer is given here.
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(InputError, match="no permission to write to"):
        require_folder(tmp_path / "a", "--out")
    with pytest.raises(InputError, match="no permission to write to"):
        require_file(tmp_path / "r.json", "--json")
