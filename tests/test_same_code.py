"""``tools/same_code.py``: moves without a trace, and changes that it must not overlook."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "tools" / "same_code.py"
LAW = '''"""The law."""
SLOPE = 2.0

def torque(speed: float) -> float:
    """Return it."""
    return SLOPE * speed

class Joint:
    def load(self, speed: float) -> float:
        return torque(speed)
'''
USER = """import identification.law as law

def twice(speed: float) -> float:
    return 2.0 * law.torque(speed)
"""
MOVED_USER = """from identification.model.friction import torque as friction

def twice(speed: float) -> float:
    return 2.0 * friction(speed)
"""
HOME = "identification/model/friction.py"


def commit(root: Path, files: dict[str, str]) -> None:
    git = ["git", "-C", str(root), "-c", "user.name=t", "-c", "user.email=t@localhost"]
    if (root / ".git").exists():
        subprocess.run([*git, "rm", "-rq", "."], check=True)
    else:
        subprocess.run([*git, "init", "-q"], check=True)
    packages = {f"{package}/__init__.py": "" for package in ("drivers", "identification", "rig")}
    for name, text in (packages | files).items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    subprocess.run([*git, "add", "."], check=True)
    subprocess.run([*git, "commit", "-qm", "state"], check=True)


def compared(root: Path, after: dict[str, str]) -> tuple[int, list[str]]:
    commit(root, {"identification/law.py": LAW, "rig/user.py": USER})
    commit(root, after)
    command = [sys.executable, str(SCRIPT), "HEAD~1", "HEAD"]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    assert not done.stderr
    return done.returncode, done.stdout.splitlines()


def test_a_move_with_other_imports_and_docstrings_is_the_same(tmp_path: Path) -> None:
    law = LAW.replace("Return it", "Return the torque")
    status, lines = compared(tmp_path, {HOME: law, "rig/user.py": MOVED_USER})
    assert lines[0] == "5 definitions, 5 the same, 4 of them moved"
    assert status == 0


@pytest.mark.parametrize(
    ("law", "user", "difference"),
    [
        (LAW.replace("2.0", "3.0"), MOVED_USER, ["- identification.law SLOPE"]),
        (LAW.replace("SLOPE * ", "SLOPE + "), MOVED_USER, ["- identification.law torque"]),
        (LAW.replace("SLOPE", "RATE"), MOVED_USER, ["~ SLOPE -> RATE (2)"]),
    ],
)
def test_a_change_in_a_move_is_printed(
    tmp_path: Path, law: str, user: str, difference: list[str]
) -> None:
    status, lines = compared(tmp_path, {HOME: law, "rig/user.py": user})
    assert [line for line in lines if line[0] in "~-"] == difference
    assert status == 1


def test_a_name_that_stands_for_another_definition_is_printed(tmp_path: Path) -> None:
    """Another module has a function of the same name."""
    other = "def torque(speed: float) -> float:\n    return 0.0\n"
    user = USER.replace("identification.law", "identification.other")
    files = {"identification/law.py": LAW, "identification/other.py": other, "rig/user.py": user}
    status, lines = compared(tmp_path, files)
    assert "- rig.user twice" in lines
    assert status == 1
