"""Runs the tests of a module on every mutant of it, each in a forked child that starts warm.

The parent has imported libraries and nothing of the project; each child imports the changed module
in the place of the module, and everything else anew.
"""

import ast
import json
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_loader
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import Phase, settings

from .mutation import mutants, mutate

_CPU_FACTOR, _CPU_S, _WALL_S = 5.0, 5.0, 120.0
"""A mutant may take so many times the tests' own processor time, and so much more; or this long in
all.
"""
_LOOK_S = 0.002
_LIVES, _KILLED = 0, 1


@dataclass
class Verdict:
    """What came of a module's mutants.

    Attributes:
        total: How many there are.
        slow: How many were ended by their time limit, which counts as noticed.
        living: Those with which all tests pass: first line and words.
        trouble: Why nothing can be said; empty where it can.
        seconds: How long it took.
    """

    total: int = 0
    slow: int = 0
    living: list[tuple[int, str]] = field(default_factory=list)
    trouble: str = ""
    seconds: float = 0.0


def judge(name: str, tests: Sequence[str], root: Path, jobs: int, only: str = "") -> Verdict:
    """Run the tests of a module on its mutants.

    Args:
        name: Of the module.
        tests: Files, relative to ``root``.
        root: Of the repository; the working directory.
        jobs: How many children run at a time.
        only: Only mutants whose words contain this.
    """
    began = time.monotonic()
    path = root / f"{name.replace('.', '/')}.py"
    source = path.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as scratch:
        told = Path(scratch, "times.json")

        def task(tree: ast.Module, cpu_s: float, times_s: Mapping[str, float]) -> _Task:
            code = compile(tree, str(path), "exec")
            plugin = _Times(told, times_s)
            return _Task(lambda: _test(_Changed(name, path, code), scratch, tests, plugin), cpu_s)

        plain = task(ast.parse(source), _WALL_S, {})
        _run([plain], 1)
        if plain.status != _LIVES:
            return Verdict(trouble="its tests fail without any change; mend them first")
        cpu_s, times_s = json.loads(told.read_text())
        chosen = [mutant for mutant in mutants(source) if only in mutant.words]
        tasks = [task(mutate(source, mutant), cpu_s, times_s) for mutant in chosen]
        _run(tasks, jobs)
    pairs = zip(chosen, tasks, strict=True)
    living = sorted((m.first, m.words) for m, done in pairs if done.status == _LIVES)
    slow = sum(done.slow for done in tasks)
    return Verdict(len(chosen), slow, living, "", time.monotonic() - began)


@dataclass
class _Task:
    """What to do in a child, and what came of it."""

    action: Callable[[], int]
    cpu_s: float
    status: int | None = None
    slow: bool = False


def _run(tasks: Sequence[_Task], jobs: int) -> None:
    """Run each task in a forked child."""
    running: dict[int, tuple[_Task, float]] = {}
    waiting = list(tasks[::-1])
    # A computer, or this program, that was suspended meanwhile is no fault of a mutant.
    awake_s, looked = 0.0, time.monotonic()
    while waiting or running:
        while waiting and len(running) < jobs:
            task = waiting.pop()
            child = os.fork()
            if child == 0:
                _become_child(task)
            running[child] = task, awake_s + _WALL_S + _CPU_FACTOR * task.cpu_s
        time.sleep(_LOOK_S)
        now = time.monotonic()
        awake_s, looked = awake_s + min(now - looked, 100 * _LOOK_S), now
        for child, (task, limit_s) in list(running.items()):
            done, status = os.waitpid(child, os.WNOHANG)
            if not done and awake_s > limit_s:
                os.kill(child, signal.SIGKILL)
                done, status = os.waitpid(child, 0)
            if done:
                del running[child]
                code = os.waitstatus_to_exitcode(status)
                task.status = _LIVES if code == _LIVES else _KILLED
                task.slow = code in (-signal.SIGKILL, -signal.SIGXCPU)
                try:
                    os.killpg(child, signal.SIGKILL)
                except ProcessLookupError:
                    continue


def _become_child(task: _Task) -> None:
    status = _KILLED
    try:
        # In a session of its own: what a mutant does to its terminal and its group stays there.
        os.setsid()
        limit_s = round(_CPU_S + _CPU_FACTOR * task.cpu_s)
        resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        null = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1, 2):
            os.dup2(null, descriptor)
        status = task.action()
    finally:
        os._exit(status)


class _Changed:
    """A finder and loader of one module, whose code is given."""

    def __init__(self, name: str, path: Path, code: object) -> None:
        self._name, self._path, self._code = name, path, code

    def find_spec(self, name: str, *_: object) -> ModuleSpec | None:
        if name != self._name:
            return None
        return spec_from_loader(name, self, origin=str(self._path))  # type: ignore[arg-type]

    def create_module(self, spec: ModuleSpec) -> None:
        """Leave it to the interpreter."""

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = str(self._path)
        exec(self._code, module.__dict__)  # type: ignore[call-overload] # noqa: S102 the mutant


class _Times:
    """A plugin: puts the quick tests first, and writes down what each takes if that is unknown."""

    def __init__(self, told: Path, times_s: Mapping[str, float]) -> None:
        self._told, self._known = told, times_s
        self._times_s: dict[str, float] = {}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items.sort(key=lambda item: self._known.get(item.nodeid, 0.0))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._times_s[report.nodeid] = self._times_s.get(report.nodeid, 0.0) + report.duration

    def pytest_sessionfinish(self) -> None:
        if not self._known:
            self._told.write_text(json.dumps([time.process_time(), self._times_s]))


def _test(changed: _Changed, scratch: str, tests: Sequence[str], plugin: _Times) -> int:
    """Run the tests with a changed module until one fails."""
    sys.meta_path.insert(0, changed)  # type: ignore[arg-type]
    # No shrinking: that a test fails is enough.
    phases = (Phase.explicit, Phase.generate)
    settings.register_profile(
        "mutants", deadline=None, derandomize=True, phases=phases, database=None
    )
    arguments = [
        *("-x", "-q", "-p", "no:cacheprovider", "--capture=sys", "--hypothesis-profile=mutants"),
        *("-W", "ignore::pytest.PytestAssertRewriteWarning"),
        *(f"--basetemp={scratch}/{os.getpid()}", "-o", "tmp_path_retention_policy=none"),
    ]
    return int(pytest.main([*arguments, *tests], plugins=[plugin]))
