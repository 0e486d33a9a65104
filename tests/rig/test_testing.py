"""The plugin for pytest: a bench test in an empty project, what a failed limit says, statuses."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from rig.cli import entry
from rig.common.provenance import sha256_file
from rig.testing import Bench, Run

from .conftest import IDENTIFIED, SHORT, run_in

ROOT = Path(__file__).parents[2]
TESTS = """\
import pytest
pytestmark = pytest.mark.rig("short.yaml")
def test_within(rig_run):
    assert rig_run.within("tracking error rms < 0.5 deg")
def test_outside(rig_run):
    assert rig_run.within("tracking error rms < 0.5 deg", "current worst < 1 mA")
"""
CONFTEST = """\
import sys
def pytest_collection_finish():
    print("loaded:", *(n for n in sys.modules if n.startswith(("rig.", "numpy", "click"))))
"""


def test_a_bench_test_in_an_empty_project(tmp_path: Path) -> None:
    project, installed = tmp_path / "project", tmp_path / "installed"
    project.mkdir()
    (project / "short.yaml").write_text(SHORT)
    (project / "test_bench.py").write_text(TESTS)
    (project / "conftest.py").write_text(CONFTEST)
    # As pip installs the entry point of the project file.
    points = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]
    info = installed / "loadrig_points-0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: loadrig-points\nVersion: 0\n")
    lines = (f"{name} = {module}\n" for name, module in points["pytest11"].items())
    (info / "entry_points.txt").write_text("[pytest11]\n" + "".join(lines))
    words = ["-q", "-s", "-p", "no:cacheprovider", "--rig-out", "out", "--junitxml", "junit.xml"]
    ended = subprocess.run(
        [sys.executable, "-m", "pytest", *words],
        cwd=project,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(installed), *sys.path])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 1, ended.stdout + ended.stderr
    loaded = next(line for line in ended.stdout.splitlines() if line.startswith("loaded:"))
    assert loaded.split()[1:] == ["rig.testing"]
    cases = {case.get("name"): case for case in ET.parse(project / "junit.xml").iter("testcase")}
    page = project / "out" / "short-1" / "run.html"
    assert page.is_file()
    # Both tests share one run.
    assert [path.name for path in (project / "out").iterdir() if path.is_dir()] == ["short-1"]
    for case in cases.values():
        assert [each.get("value") for each in case.iter("property")] == [str(page)]
    assert cases["test_within"].find("failure") is None
    failure = cases["test_outside"].find("failure")
    assert failure is not None
    message = failure.get("message", "")
    assert "current worst < 1 mA" in message
    assert "tracking error" not in message
    assert page.as_uri() in message
    assert f"loadrig {page.parent}" in ended.stdout


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """An identified run of the fake bench: Mc is 6.8 N m, from 6.7 to 6.9."""
    folder = run_in(tmp_path_factory.mktemp("made")).path
    recording = {"file": "recording.mcap", "sha256": sha256_file(folder / "recording.mcap")}
    (folder / "identify.json").write_text(json.dumps({**IDENTIFIED, "inputs": [recording]}))
    return Run(folder)


def test_a_failed_limit_says_by_how_much(run: Run) -> None:
    assert run.within("lost samples < 5", Mc=(6.5, 7.1))
    assert run.within(Mc=(None, 6.9))
    assert run.constants()["Mc"].value == 6.8
    cases = {(6.75, None): "0.05 N m", (6.5, 6.6): "0.3 N m", (7.0, 7.5): "0.3 N m"}
    for ends, beyond in cases.items():
        with pytest.raises(AssertionError) as raised:
            run.within("lost samples < 5", Mc=ends)
        head, failed, page = str(raised.value).splitlines()
        assert head.startswith("1 of 3 ")
        assert failed.strip().startswith(f"Mc: {ends[0]}..")
        assert f"; {beyond} " in failed
        assert page.endswith(run.page.as_uri())
    with pytest.raises(AssertionError, match="Ms"):
        run.within(Ms=(1.0, 2.0))
    for wrong in ({"Mx": (1.0, 2.0)}, {"Mc": (2.0, 1.0)}):
        with pytest.raises(ValueError, match=r"constant|empty"):
            run.within(**wrong)


def test_the_limits_of_a_file(run: Run, tmp_path: Path) -> None:
    limits = tmp_path / "limits.yaml"
    limits.write_text("acceptance: 1\nlimits: ['Mc: 6.5..7.1']\n")
    assert run.accepted(limits)
    limits.write_text("acceptance: 1\nlimits: ['Mc: 6.5..6.6']\n")
    with pytest.raises(AssertionError, match=re.escape("6.5..6.6")):
        run.accepted(str(limits))


def test_how_a_run_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[list[str]] = []
    bench = Bench("real.yaml", tmp_path, 60.0)

    def end_with(code: int) -> None:
        monkeypatch.setattr(entry, "status", lambda words: asked.append(words) or code)
        bench.run("short.yaml", "--seed", "3")

    end_with(entry.DONE)
    end_with(entry.BAD_VERDICT)
    assert asked[0] == [
        *("run", "short.yaml", "--bench", "real.yaml", "--out", str(tmp_path / "short-1")),
        *("--yes", "--wait", "60.0", "--seed", "3"),
    ]
    assert asked[1][5] == str(tmp_path / "short-2")
    with pytest.raises(KeyboardInterrupt):
        end_with(entry.STOPPED)
    for code in (entry.BAD_INPUT, entry.DEVICE_FAILED, entry.CRASHED):
        with pytest.raises(pytest.fail.Exception):
            end_with(code)
    # A shared run that failed is not repeated by the other tests.
    for _ in range(2):
        with pytest.raises(pytest.fail.Exception):
            bench.shared("other.yaml")
    assert [words[1] for words in asked].count("other.yaml") == 1
