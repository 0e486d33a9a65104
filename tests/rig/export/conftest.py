"""A run on the fake bench, which the tests export."""

from pathlib import Path
from typing import Any

import pytest


@pytest.fixture
def run(runner: Any, fake_bench: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of a run; the present folder is that of the test."""
    monkeypatch.chdir(tmp_path)
    folder, _ = runner(fake_bench())
    return Path(folder.path)
