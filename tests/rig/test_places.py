"""Results arrive whole or not at all, and nothing that is no plain file is replaced."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import pytest

from rig.common.errors import InputError
from rig.common.places import replacing, require_file, require_folder, write_json, write_text


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    write_json(path, {"a": 1})
    write_json(path, {"a": 2})
    assert json.loads(path.read_text()) == {"a": 2}
    assert names(tmp_path) == ["r.json"]


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt()])
def test_the_earlier_version_survives_and_no_draft_is_left(
    tmp_path: Path, error: BaseException
) -> None:
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


def test_places_that_will_do(tmp_path: Path) -> None:
    require_folder(tmp_path / "a" / "b" / "c", "--out")
    require_folder(tmp_path, "--out")
    require_file(None, "--json")
    require_file(tmp_path / "r.json", "--json")
    require_file(Path(os.devnull), "--json")
    assert names(tmp_path) == []


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
