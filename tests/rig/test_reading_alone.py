"""Recordings are read and evaluated without the drivers: on a computer that has no bus."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.rig.test_identify_command import write_campaign

PROGRAM = """
import sys
from rig.cli.entry import status
campaign, out = sys.argv[1:]
assert status(["look", campaign]) == status(["identify", campaign, "--out", out]) == 0
assert not status(["diagnose", "--observable", campaign])
from rig.results.diagnose import diagnose
from rig.runs import run
print(*(name for name in sys.modules if name.split(".")[0] == "drivers"), file=sys.stderr)
"""


def test_a_campaign_is_identified_and_diagnosed_without_a_driver(tmp_path: Path) -> None:
    arguments = [sys.executable, "-c", PROGRAM, str(write_campaign(tmp_path)), str(tmp_path / "o")]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.split()) == (0, []), done.stderr
