"""A module that is imported in a thread while the program computes."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

import pytest

from rig.common.start_up import imported_ahead


def test_the_module_is_there_at_the_end_of_the_block(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "imported_once.py").write_text("import threading\nBY = threading.current_thread()")
    monkeypatch.syspath_prepend(tmp_path)
    with imported_ahead("imported_once"):
        pass
    by = sys.modules.pop("imported_once").BY
    assert by is not threading.main_thread()
    assert not by.is_alive()


def test_an_error_is_left_to_the_import_that_follows() -> None:
    with imported_ahead("no_such_module"):
        done = True
    assert done
    with pytest.raises(ModuleNotFoundError):
        __import__("no_such_module")
