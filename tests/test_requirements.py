"""What ``pip install .`` brings is what every command imports."""

import json
import re
import subprocess
import sys
import tomllib
from contextlib import suppress
from importlib import metadata
from pathlib import Path

_PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]


def _name(requirement: str) -> str:
    """Normalised name of a distribution (PEP 503)."""
    return re.sub(r"[-_.]+", "-", re.split(r"[^\w.-]", requirement)[0]).lower()


def _needed(names: list[str]) -> set[str]:
    """Names of the distributions that these requirements install, without extras."""
    found: set[str] = set()
    waiting = [_name(requirement) for requirement in names]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        found.add(name)
        with suppress(metadata.PackageNotFoundError):  # needed by other systems only
            waiting += [
                _name(requirement)
                for requirement in metadata.requires(name) or ()
                if "extra ==" not in requirement
            ]
    return found


_IMPORT = """
import importlib, json, sys
sys.modules.update(dict.fromkeys(json.loads(sys.argv[1])))
from rig.cli.entry import COMMANDS
for module, _ in COMMANDS.values():
    importlib.import_module(f"rig.cli.commands.{module}")
importlib.import_module("rig.console.app")
"""


def test_the_base_installation_imports_every_command() -> None:
    """The next steps of the README follow `make demo`, which installs no extra."""
    base = {"loadrig", *_needed(_PROJECT["dependencies"])}
    others = [
        package
        for package, distributions in metadata.packages_distributions().items()
        if base.isdisjoint(map(_name, distributions))
    ]
    assert "pytest" in others
    done = subprocess.run(
        [sys.executable, "-c", _IMPORT, json.dumps(others)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
