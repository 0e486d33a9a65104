"""Plugin for pytest: runs sequences on a bench in tests, and states limits as assertions.

pytest loads the plugin in every project of the environment, therefore all of this program is
imported only when a test runs a bench.
"""

from __future__ import annotations

import gc
import itertools
from collections.abc import Generator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from rig.config.acceptance import Limit
    from rig.results.acceptance.evidence import Check
    from rig.runs.catalogue.entry import Constant


@dataclass(frozen=True)
class Run:
    """A finished run."""

    folder: Path  # the run folder

    @property
    def page(self) -> Path:
        """The report of the identification, or the page of the run if it is not identified."""
        report = self.folder / "report.html"
        return report if report.is_file() else self.folder / "run.html"

    def constants(self) -> Mapping[str, Constant]:
        """Return the identified constants by name; the run is identified if it was not."""
        from rig.config.acceptance import parse_limit
        from rig.results.acceptance.evidence import gather

        need = parse_limit("torque error rms > 0 N m")
        return gather(self.folder, [need], lambda words, share: None).constants

    def within(self, *limits: str, **ranges: tuple[float | None, float | None]) -> bool:
        """Return True if the run is complete and within limits.

        Args:
            limits: Acceptance limits as in a sequence, such as ``tracking error rms < 0.05 deg``.
            ranges: Least and greatest value of a constant, SI; None for an open end. The whole
                90 % interval must be inside.

        Raises:
            AssertionError: A limit is not met; the message has each such limit, the distance to it
                and the page of the run.
            ValueError: A text is no limit.
        """
        __tracebackhide__ = True
        from rig.config.acceptance import parse_limit

        lines = list(limits)
        for name, ends in ranges.items():
            low, high = ("" if end is None else float(end) for end in ends)
            lines.append(f"{name}: {low}..{high}")
        return self._judged([parse_limit(line) for line in lines])

    def accepted(self, limits: Path | str | None = None) -> bool:
        """Return True if the run is complete and within the limits of a file, else of its sequence.

        Raises:
            AssertionError: As :meth:`within`.
            InputError: The file cannot be read, or the sequence has no limits.
        """
        __tracebackhide__ = True
        from rig.cli.accepting import limits_for

        return self._judged(limits_for(self.folder, None if limits is None else Path(limits))[0])

    def _judged(self, limits: Sequence[Limit]) -> bool:
        __tracebackhide__ = True
        from rig.results.acceptance.evidence import gather, judge

        checks = judge(limits, gather(self.folder, limits, lambda words, share: None))
        by_limit: list[Limit | None] = [None] * (len(checks) - len(limits)) + [*limits]
        failed = [
            f"  {check.limit}: {check.words}{_distance(limit, check)}"
            for limit, check in zip(by_limit, checks, strict=True)
            if not check.passed
        ]
        if failed:
            words = f"{len(failed)} of {len(checks)} limits not met"
            raise AssertionError("\n".join([words, *failed, f"  page: {self.page.as_uri()}"]))
        return True

    def summary(self) -> str:
        """Return what ``rig runs show`` prints of the run, and the link to its page."""
        from rig.results.catalogue.listing import show_document
        from rig.results.document import text
        from rig.runs.catalogue.index import list_runs

        (entry,) = list_runs(self.folder).entries
        return f"{text(show_document(self.folder, entry))}\n\npage: {self.page.as_uri()}"


def _distance(limit: Limit | None, check: Check) -> str:
    """Return how far a value or the end of its interval is beyond its limit, as text."""
    from rig.common.tables import number
    from rig.config.acceptance import Bound, Range

    beyond = 0.0
    if isinstance(limit, Bound) and check.value is not None:
        beyond = abs(check.value - limit.value)
    elif isinstance(limit, Range):
        ends = [end for end in (check.low, check.value, check.high) if end is not None]
        beyond = max([limit.low - end for end in ends] + [end - limit.high for end in ends] + [0.0])
    return f"; {number(beyond, 3)} {check.unit} beyond the limit" if beyond else ""


@dataclass
class Bench:
    """A bench that tests run sequences on."""

    name: str  # bench file, or the name of a packaged bench
    out: Path  # folder of the run folders
    wait_s: float = 0.0  # time, s, to wait while another program uses the bench
    used: list[Run] = field(default_factory=list)  # runs that the present test uses
    _shared: dict[str, Run | None] = field(default_factory=dict)

    def run(self, sequence: str | Path, *options: str) -> Run:
        """Run a sequence, as ``rig run`` does with these options; returns every run that began.

        A test fails if the run cannot begin, or if a device or the bus fails.
        """
        __tracebackhide__ = True
        from rig.cli.entry import BAD_VERDICT, GARBAGE_THRESHOLD, STOPPED, status

        for number in itertools.count(1):
            folder = self.out / f"{Path(sequence).stem}-{number}"
            with suppress(FileExistsError):
                folder.mkdir(parents=True)
                break
        words = ["run", str(sequence), "--bench", self.name, "--out", str(folder), "--yes"]
        words += ["--wait", str(self.wait_s), *options]
        before = gc.get_threshold()
        gc.set_threshold(GARBAGE_THRESHOLD)
        try:
            code = status(words)
        finally:
            gc.set_threshold(*before)
        if (folder / "run.json").is_file():
            self.used.append(Run(folder))
        if code == STOPPED:
            raise KeyboardInterrupt
        if code > BAD_VERDICT:
            pytest.fail(f"`rig {' '.join(words)}` ended with status {code}; see its output")
        return Run(folder)

    def shared(self, sequence: str) -> Run:
        """Return the run of a sequence that all tests of the session share."""
        if sequence not in self._shared:
            self._shared[sequence] = None
            self._shared[sequence] = self.run(sequence)
        found = self._shared[sequence]
        if found is None:
            pytest.fail(f"the run of {sequence} failed in an earlier test")
        self.used.append(found)
        return found


_BENCH = pytest.StashKey[Bench]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of the plugin."""
    add = parser.getgroup("loadrig").addoption
    add("--rig-bench", metavar="BENCH", default="practical", help="Bench file, or packaged bench.")
    add("--rig-out", metavar="DIR", help="Folder of the run folders; a temporary one by default.")
    words = "Time to wait for a bench that another program uses."
    add("--rig-wait", metavar="SECONDS", type=float, default=0.0, help=words)


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker of the plugin."""
    words = "sequence of the fixture rig_run (default: quick_check)"
    config.addinivalue_line("markers", f"rig(sequence): {words}")


@pytest.fixture(scope="session")
def rig_bench(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """The bench of `--rig-bench`, by default a simulated bench in simulated time."""
    option = request.config.getoption
    out = option("--rig-out")
    folder = tmp_path_factory.mktemp("rig") if out is None else Path(out).absolute()
    bench = Bench(option("--rig-bench"), folder, option("--rig-wait"))
    request.config.stash[_BENCH] = bench
    return bench


@pytest.fixture
def rig_run(request: pytest.FixtureRequest, rig_bench: Bench) -> Run:
    """The run of the sequence of the marker `rig`; tests with one sequence share one run."""
    marker = request.node.get_closest_marker("rig")
    return rig_bench.shared(marker.args[0] if marker else "quick_check")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Attach the runs of a failed test to its report, and name the runs of every test in JUnit."""
    bench = item.config.stash.get(_BENCH, None)
    values = getattr(item, "funcargs", {}).values()
    used = [value for value in values if isinstance(value, Run)]
    used = list(dict.fromkeys([*used, *(bench.used if bench else ())]))
    used = [run for run in used if (run.folder / "run.json").is_file()]
    if call.when == "call":
        item.user_properties += [("loadrig page", str(run.page)) for run in used]
    report = yield
    if report.failed:
        report.sections += [(f"loadrig {run.folder}", run.summary()) for run in used]
    if bench and call.when == "teardown":
        bench.used.clear()
    return report
