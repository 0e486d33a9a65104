"""Runs the tests of a module on every mutant of it, each in a forked child that starts warm.

A mutant of a function's body takes the place of the function's code where the module, its users and
the tests are imported already, and meets only the tests that reach its statement, the quickest
first. One of anything else (a table, a default, a class body) needs every user of the module to be
imported again.
"""

from __future__ import annotations

import ast
import gc
import importlib.util
import json
import os
import resource
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import Any

import pytest
from hypothesis import Phase, settings

from .mutation import Mutant, mutants, mutate

PACKAGES = ("rig", "drivers", "identification", "tests")
_CPU_FACTOR, _CPU_S, _WALL_S = 5.0, 5.0, 120.0
"""A mutant may take so many times the tests' own processor time, and so much more; or this long in
all.
"""
_LOOK_S = 0.002
_LIVES, _KILLED, _BROKEN = 0, 1, 99
Function = tuple[str, int]
"""Qualified name and first line."""
Functions = Mapping[Function, Sequence[FunctionType]]
"""The live functions of a module; a class that is made twice has its functions once."""


@dataclass
class Verdict:
    """What came of a module's mutants.

    Attributes:
        total: How many there are.
        slow: How many were ended by their time limit, which counts as noticed.
        living: Those with which all tests pass: first line, words, and whether any test reaches
            them.
        trouble: Why nothing can be said; empty where it can.
        seconds: How long it took.
    """

    total: int = 0
    slow: int = 0
    living: list[tuple[int, str, bool]] = field(default_factory=list)
    trouble: str = ""
    seconds: float = 0.0


def judge(name: str, tests: Sequence[str], root: Path, jobs: int, only: str = "") -> Verdict:
    """Run the tests of a module on its mutants, in a process of its own.

    Args:
        name: Of the module.
        tests: Files, relative to ``root``.
        root: Of the repository; the working directory.
        jobs: How many children run at a time.
        only: Only mutants whose words contain this.
    """
    began = time.monotonic()
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        with os.fdopen(writing, "w", encoding="utf-8") as report:
            _silence()
            json.dump(_judged(name, tests, root, jobs, only).__dict__, report)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, encoding="utf-8") as report:
        said = report.read()
    os.waitpid(child, 0)
    if not said:
        return Verdict(trouble="the tests ended the process")
    verdict = Verdict(**json.loads(said))
    verdict.seconds = time.monotonic() - began
    return verdict


def _judged(name: str, tests: Sequence[str], root: Path, jobs: int, only: str) -> Verdict:
    path = root / f"{name.replace('.', '/')}.py"
    source = path.read_text(encoding="utf-8")
    everything = [mutant for mutant in mutants(source) if only in mutant.words]
    verdict = Verdict(len(everything))
    warm = _Warm(
        name,
        str(path),
        source,
        [mutant for mutant in everything if mutant.function is not None],
        jobs,
    )
    with tempfile.TemporaryDirectory() as scratch:
        ended = pytest.main(_arguments(scratch, tests), plugins=[warm])
        if warm.trouble or ended == pytest.ExitCode.INTERNAL_ERROR or not warm.times_s:
            return Verdict(trouble=warm.trouble or "its tests cannot be collected and run")
        results = warm.results

        def cold(mutant: Mutant | None) -> _Task:
            tree = ast.parse(source) if mutant is None else mutate(source, mutant)
            return _Task(
                lambda: _cold(name, path, tree, scratch, tests, warm.times_s),
                sum(warm.times_s.values()),
            )

        results |= {
            mutant: cold(mutant)
            for mutant in everything
            if mutant.function is None or mutant in warm.left
        }
        unchanged = cold(None)
        _run([unchanged], 1)
        if unchanged.status != _LIVES:
            return Verdict(trouble="its tests fail where it is imported again")
        _run([task for task in results.values() if task.status is None], jobs)
    broken = [mutant.words for mutant, task in results.items() if task.status == _BROKEN]
    if broken:
        return Verdict(trouble=f"the runner itself failed on {broken}")
    verdict.slow = sum(task.slow for task in results.values())
    verdict.living = sorted(
        (mutant.first, mutant.words, task.reached)
        for mutant, task in results.items()
        if task.status == _LIVES
    )
    return verdict


@dataclass
class _Task:
    """What to do in a child, and what came of it."""

    action: Callable[[], int]
    cpu_s: float = 0.0
    reached: bool = True
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
                task.status = code if code in (_LIVES, _BROKEN) else _KILLED
                task.slow = code in (-signal.SIGKILL, -signal.SIGXCPU)
                _end_group(child)


def _become_child(task: _Task) -> None:
    status = _BROKEN
    try:
        # In a session of its own: what a mutant does to its terminal and its group stays there.
        os.setsid()
        limit_s = round(_CPU_S + _CPU_FACTOR * task.cpu_s)
        resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        status = task.action()
    except (KeyboardInterrupt, SystemExit, pytest.exit.Exception):
        # What a test raises and pytest does not keep.
        status = _KILLED
    finally:
        os._exit(status)


def _end_group(child: int) -> None:
    try:
        os.killpg(child, signal.SIGKILL)
    except ProcessLookupError:
        return


class _Warm:
    """A plugin: runs the collected tests once, notes which statements each reaches, then runs them
    on the mutants.

    Attributes:
        results: What came of each mutant; empty where the tests fail without any change.
        left: Mutants whose code does not fit into the place of the function's.
        trouble: Why there are no results.
        times_s: Processor time of each test.
    """

    def __init__(
        self, name: str, path: str, source: str, everything: Sequence[Mutant], jobs: int
    ) -> None:
        self._name, self._path, self._source = name, path, source
        self._everything, self._jobs = everything, jobs
        self._failed: list[str] = []
        self.results: dict[Mutant, _Task] = {}
        self.left: list[Mutant] = []
        self.trouble = ""
        self.times_s: dict[str, float] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self._failed.append(f"{report.nodeid}: {report.longreprtext[-300:]}")

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        if session.testsfailed:
            return True
        reach = [self._reach(item, following) for item, following in _with_next(session.items)]
        if self._failed:
            self.trouble = (
                f"its tests fail without any change; mend them first: {'; '.join(self._failed)}"
            )
            return True
        self.times_s = {
            item.nodeid: cpu_s for item, (cpu_s, _, _) in zip(session.items, reach, strict=True)
        }
        functions = _functions(self._path)
        gc.freeze()
        quick = sorted(zip(session.items, reach, strict=True), key=lambda pair: pair[1][0])
        for mutant in self._everything:
            assert mutant.function is not None
            lines = set(range(mutant.first, mutant.last + 1))
            met = [(item, cpu_s) for item, (cpu_s, seen, _) in quick if lines & seen]
            if not met:
                # The interpreter tells nothing of some statements, such as `while True`.
                met = [
                    (item, cpu_s)
                    for item, (cpu_s, _, entered) in quick
                    if mutant.function in entered
                ]
            code = _code(compile(mutate(self._source, mutant), self._path, "exec"), mutant.function)
            places = functions.get(mutant.function)
            if (
                code is None
                or not places
                or any(code.co_freevars != place.__code__.co_freevars for place in places)
            ):
                self.left.append(mutant)
                continue
            items = [item for item, _ in met]
            changed = {mutant.function: code}
            task = _Task(
                lambda changed=changed, items=items: self._test(functions, changed, items),  # type: ignore[misc]
                sum(cpu_s for _, cpu_s in met),
                bool(met),
            )
            self.results[mutant] = task
        self._failed = []
        original = compile(self._source, self._path, "exec")
        same = {key: code for key in functions if (code := _code(original, key)) is not None}
        control = _Task(
            lambda: self._test(functions, same, session.items), sum(self.times_s.values())
        )
        _run([control], 1)
        if control.status != _LIVES:
            self.trouble = "its tests fail where its functions' code is replaced by the same"
            self.results = {}
            return True
        _run(list(self.results.values()), self._jobs)
        return True

    def _reach(
        self, item: pytest.Item, following: pytest.Item | None
    ) -> tuple[float, set[int], set[Function]]:
        """Run a test; returns its processor time, and which lines and functions of the module it
        reaches.
        """
        lines: set[int] = set()
        entered: set[Function] = set()
        path = self._path

        def inside(frame: FrameType, event: str, argument: object) -> Any:
            if event == "line":
                lines.add(frame.f_lineno)
            return inside

        def trace(frame: FrameType, event: str, argument: object) -> Any:
            code = frame.f_code
            if code.co_filename != path:
                return None
            entered.add((code.co_qualname, code.co_firstlineno))
            return inside

        began = time.process_time()
        sys.settrace(trace)
        threading.settrace(trace)
        try:
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        finally:
            sys.settrace(None)
            threading.settrace(None)  # type: ignore[arg-type]
        return time.process_time() - began, lines, entered

    def _test(
        self,
        functions: Functions,
        changed: Mapping[Function, CodeType],
        items: Sequence[pytest.Item],
    ) -> int:
        """Put changed code into the place of functions' and run tests until one fails."""
        for key, code in changed.items():
            for function in functions[key]:
                function.__code__ = code
        for item, following in _with_next(items):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if self._failed:
                return _KILLED
        return _LIVES


def _with_next(items: Sequence[pytest.Item]) -> Iterator[tuple[pytest.Item, pytest.Item | None]]:
    return zip(items, [*items[1:], None][: len(items)], strict=True)


def _functions(path: str) -> Functions:
    """Return the live functions of a module, by qualified name and first line."""
    found: dict[Function, list[FunctionType]] = {}
    for thing in gc.get_objects():
        # Not isinstance(), which asks the thing itself.
        if type(thing) is FunctionType and thing.__code__.co_filename == path:
            found.setdefault(
                (thing.__code__.co_qualname, thing.__code__.co_firstlineno), []
            ).append(thing)
    return found


def _code(code: CodeType, function: Function) -> CodeType | None:
    """Return the code of a function in that of its module."""
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            if (constant.co_qualname, constant.co_firstlineno) == function:
                return constant
            found = _code(constant, function)
            if found is not None:
                return found
    return None


def _cold(
    name: str,
    path: Path,
    tree: ast.Module,
    scratch: str,
    tests: Sequence[str],
    times_s: Mapping[str, float],
) -> int:
    """Import a changed module and, again, everything that uses it; run the tests, the quickest
    first.
    """
    for user in _users(name):
        del sys.modules[user]
    specification = importlib.util.spec_from_file_location(name, path)
    assert specification is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[name] = module
    parent, _, leaf = name.rpartition(".")
    setattr(sys.modules[parent], leaf, module)
    try:
        exec(compile(tree, str(path), "exec"), module.__dict__)  # noqa: S102 the mutant itself
    except Exception:  # noqa: BLE001 a module that cannot be imported is noticed
        return _KILLED
    return int(pytest.main(["-x", *_arguments(scratch, tests)], plugins=[_QuickFirst(times_s)]))


class _QuickFirst:
    """A plugin: puts the quick tests first."""

    def __init__(self, times_s: Mapping[str, float]) -> None:
        self._times_s = times_s

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items.sort(key=lambda item: self._times_s.get(item.nodeid, 0.0))


def _users(name: str) -> set[str]:
    """Return the loaded modules of the project that use a module, directly or not, with itself and
    all tests.
    """
    packages = {name.partition(".")[0], *PACKAGES}
    ours = {module for module in sys.modules if module.partition(".")[0] in packages}
    uses = {module: _imports(module, ours) for module in ours}
    found = {name} | {
        module for module in ours if module.startswith("tests.") and "long" not in module
    }
    while True:
        more = {module for module in ours - found if uses[module] & found}
        if not more:
            return found & ours
        found |= more


def _imports(module: str, ours: Iterable[str]) -> set[str]:
    file = getattr(sys.modules[module], "__file__", None)
    if file is None:
        return set()
    names: set[str] = set()
    for node in ast.walk(ast.parse(Path(file).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names & set(ours)


def _arguments(scratch: str, tests: Sequence[str]) -> list[str]:
    """Return pytest's arguments; each process has its own folder for temporary files."""
    # No shrinking: that a test fails is enough.
    phases = (Phase.explicit, Phase.generate)
    settings.register_profile(
        "mutants", deadline=None, derandomize=True, phases=phases, database=None
    )
    return [
        *("-q", "-p", "no:cacheprovider", "--capture=sys", "--hypothesis-profile=mutants"),
        *("-W", "ignore::pytest.PytestAssertRewriteWarning"),
        *(f"--basetemp={scratch}/{os.getpid()}", "-o", "tmp_path_retention_policy=none"),
        *tests,
    ]


def _silence() -> None:
    null = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(null, descriptor)
