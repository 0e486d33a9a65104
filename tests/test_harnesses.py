"""The long harnesses, which no test runs, fit the program: they import, and their hooks exist."""

import json
import os
import subprocess
import sys
from pathlib import Path

HOOKED = """\
import importlib, pkgutil, tests.long
for module in pkgutil.iter_modules(tests.long.__path__, "tests.long."):
    importlib.import_module(module.name)
from tests.long import witness
for hook in witness.WATCHED.values():
    hook()
witness.main()
"""


def test_harnesses_import_and_the_witness_finds_its_hooks() -> None:
    reads, tells = os.pipe()
    env = os.environ | {"WITNESS": str(tells), "WITNESS_READY": "1"}
    words = [sys.executable, "-c", HOOKED, "jog", "--help"]
    root = Path(__file__).parents[1]
    done = subprocess.run(words, cwd=root, env=env, pass_fds=[tells], capture_output=True)
    os.close(tells)
    with os.fdopen(reads) as told:
        notices = [json.loads(line) for line in told]
    assert done.returncode == 0, done.stderr
    assert [notice["phase"] for notice in notices] == ["ready"]
