"""The page of a run that stopped: what it shows, and that it is there whatever the recording is
like.
"""

import dataclasses
import json
import math
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.interfaces import ServoState
from identification.recording import Array, Bench
from rig.cli.entry import status
from rig.common.provenance import sha256_file
from rig.common.sample import Sample
from rig.config.bench import load_bench
from rig.config.configuration import load_located
from rig.config.sequence import Sequence
from rig.config.serial_bus import GUARDED, NO_WATCHDOG
from rig.control.cycle import Cycle
from rig.control.operator import AutomaticOperator, OperatorStopError
from rig.control.safety import Check, remedy
from rig.planning.limits import Limits
from rig.planning.plan import make_plan
from rig.results.run import charts, recorded, report
from rig.results.run.charts import (
    NEVER_MOVED,
    PANELS,
    Chart,
    Frame,
    Panel,
    Plots,
    Shade,
    TimeAxis,
    chart,
)
from rig.results.run.go_on import ACCEPTANCE_FILE, CERTIFICATE_PAGE, NOT_READ_BACK
from rig.results.run.recorded import (
    COLUMNS,
    MOVING,
    NAMES,
    STATES,
    Derived,
    Deriver,
    Recorded,
    Series,
    Traces,
    Tripped,
    _gathered,
    limit_steps,
    read_attachments,
    spans,
)
from rig.results.run.report import REPORT_FILE, inlined_script, write_run_report, write_verdict
from rig.runs.mcap.reader import Block, Happening
from rig.runs.run import RunFolder
from rig.runs.run_file import read_record
from rig.runs.run_record import RUN_FILE, RunRecord, SegmentRecord

from .benches import sine, stages
from .conftest import run_in

OPENING = 3
"""Charts that a page opens with: tracking error, current and temperature."""
INSIDE = 600
"""A cycle well inside the first excitation of the short sequence."""


def page_of(folder: RunFolder) -> str:
    return write_run_report(folder.path, folder.record).read_text()


def titles(html: str) -> list[str]:
    return re.findall(r"<figcaption><b>(.*?)</b>", html)


def data_of(html: str, index: int) -> Any:
    """Return the data of a chart of a page."""
    data = html.rpartition('id="plots">')[2].partition("</script>")[0]
    return json.loads(data)["charts"][index]


def plot_of(html: str) -> int:
    """Return the index of the first chart of a part of a page."""
    return int(re.findall(r'data-plot="(\d+)"', html)[0])


def last_part(html: str) -> str:
    """Return the section of the last seconds."""
    return html.partition("<h2>The last seconds</h2>")[2].partition("<h2>")[0]


def late(bench: Any) -> None:
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 40_000_000)


def reads(**values: Any) -> Callable[[Any], object]:
    """Have the drive report other values."""
    return lambda bench: bench.overrides.update(values)


def becomes(name: str, value: Any) -> Callable[[Any], object]:
    return lambda bench: setattr(bench, name, value)


DRIVES_ERROR = "following error, as the drive computes it"
ENCODERS = "drive&#x27;s encoder less joint encoder"
LATENESS = "lateness of the control cycle, beyond a period"
SUPPLY = "supply voltage (DC link)"
TRIPS: dict[str, tuple[Callable[[Any], object], Check, str]] = {
    "angle": (becomes("angle_error", 0.6), Check.ANGLE, "joint angle"),
    "speed": (reads(velocity_rad_s=-5.0), Check.SPEED, "joint speed"),
    "current": (reads(current_A=-26.0), Check.CURRENT, "motor current"),
    "torque": (reads(current_A=20.0), Check.TORQUE, "joint torque Km i I"),
    "following error": (reads(following_error_rad=0.1), Check.FOLLOWING_ERROR, DRIVES_ERROR),
    "disagreement": (becomes("angle_error", 0.02), Check.DISAGREEMENT, ENCODERS),
    "temperature": (reads(temperature_C=99.0), Check.TEMPERATURE, "motor temperature"),
    "supply low": (reads(supply_voltage_V=20.0), Check.SUPPLY, SUPPLY),
    "supply high": (reads(supply_voltage_V=90.0), Check.SUPPLY, SUPPLY),
    "state": (becomes("drive_state", ServoState.FAULT), Check.DRIVE_STATE, "state of the drive"),
    "age": (becomes("fresh", False), Check.SAMPLE_AGE, "age of the last whole answer"),
    "lateness": (late, Check.LATENESS, LATENESS),
}
TIGHT = "limits: {torque_N_m: 50}\n"


@pytest.fixture
def tight(runner: Any, short_sequence: Path) -> Any:
    """The runner with a limit on torque that is reached before that on current."""
    short_sequence.write_text(short_sequence.read_text() + TIGHT)
    sequence = load_located(short_sequence, Sequence)
    inputs = dataclasses.replace(runner.inputs, sequence=sequence)
    return dataclasses.replace(runner, inputs=inputs, plan=make_plan(sequence, inputs.bench))


@pytest.mark.parametrize("what", TRIPS)
def test_a_trip_is_shown_first_with_its_limit_and_its_moment(what, tight, fake_bench):
    act, check, title = TRIPS[what]
    bench = fake_bench()
    bench.faults["exchange", INSIDE] = lambda: act(bench)
    folder, _ = tight(bench)
    trip = folder.record.trip
    assert trip["check"] == check.value
    html = page_of(folder)
    last = last_part(html)
    assert titles(last)[:2] == [title, f"{title}, sample by sample"]
    first = last.partition("</figure>")[0]
    shown = data_of(html, plot_of(first))
    assert shown["tall"]
    assert shown["frame"]["mark"][1] == f"{folder.record.state} {trip['time']:.3f} s"
    (panel,) = [p for p in PANELS if check in p.checks]
    # The value drawn at the moment of the trip is the one that was judged, and the limit is the one
    # it was judged by.
    tail = Recorded(folder.path, folder.record, 1).traces.tail
    at = int(np.argmin(np.abs(tail.time - trip["time"])))
    value = abs(float(tail.values[at, NAMES.index(next(iter(panel.channels)))]))
    if check is not Check.DRIVE_STATE:
        assert "BEYOND THE LIMIT" in first
        assert value == pytest.approx(abs(trip["value"]), rel=1e-9)
        bounds = [limit[-1][2] / panel.scale for limit in shown["limits"]]
        assert min(abs(bound - trip["limit"]) for bound in bounds) < 1e-9


def test_the_page_says_on_what_by_whom_and_how_to_go_on(runner: Any, fake_bench: Any) -> None:
    """Also of a trip at the first sample."""
    bench = fake_bench()
    runner.inputs = dataclasses.replace(runner.inputs, operator="Ann <b>")
    bench.faults["exchange", 1] = lambda: bench.overrides.update(current_A=26.0)
    folder, _ = runner(bench)
    html = page_of(folder)
    head = html.partition("<h2>The last seconds</h2>")[0]
    assert headline(html) == ("bad", "TRIPPED, NOT JUDGED")
    for words in (remedy(Check.CURRENT), f"rig resume {folder.path}", "SIMULATED", "Ann &lt;b&gt;"):
        assert head.count(words) == 1
    # Every channel twice, in the last seconds and as a whole, and the tripped one once more; there
    # is no pressure, and in simulated time no lateness.
    assert titles(last_part(html))[0] == "motor current"
    assert len(titles(html)) == OPENING + 2 * (len(PANELS) - 3) + 1


def headline(html: str) -> tuple[str, str]:
    """Return colour and words of the headline."""
    (found,) = re.findall(r'<p class="verdict (\w+)">([^<]*)</p>', html)
    return found


@pytest.mark.parametrize("accepted", [True, False])
def test_the_verdict_is_the_headline(accepted: bool, runner: Any, fake_bench: Any) -> None:
    folder, _ = runner(fake_bench())
    page_of(folder)
    checks = [
        {"limit": "run complete", "passed": True, "words": "done"},
        {"limit": "tracking error rms < 1 deg", "passed": accepted, "words": "found <2> deg"},
    ]
    digest = sha256_file(folder.path / RUN_FILE)
    verdict = "accepted" if accepted else "rejected"
    found = {"verdict": verdict, "checks": checks, "inputs": [{"file": RUN_FILE, "sha256": digest}]}
    (folder.path / ACCEPTANCE_FILE).write_text(json.dumps(found))
    (folder.path / CERTIFICATE_PAGE).touch()
    # The page, which was written before the run was judged, has the verdict afterwards.
    write_verdict(folder.path, folder.record)
    html = (folder.path / REPORT_FILE).read_text()
    assert headline(html) == ("good" if accepted else "bad", verdict.upper())
    assert f'<a href="{CERTIFICATE_PAGE}">' in html
    assert ("found &lt;2&gt; deg" in html) != accepted
    assert titles(html) == titles(page_of(folder)) != []
    # A verdict on an earlier state of the run is not the verdict of this run.
    folder.record.message = "changed"
    folder.save()
    write_verdict(folder.path, folder.record)
    assert headline((folder.path / REPORT_FILE).read_text()) == ("none", "DONE, NOT JUDGED")


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A run that was done, not to be changed."""
    return run_in(tmp_path_factory.mktemp("done"))


def test_a_page_opens_with_the_result_and_holds_all_it_needs(done: RunFolder) -> None:
    html = page_of(done)
    opening = html.partition("<h2>")[0]
    first = ["tracking error, command less joint encoder", "motor current", "motor temperature"]
    assert titles(opening) == first
    assert headline(html) == ("none", "DONE, NOT JUDGED")
    assert opening.index("NOT JUDGED") < opening.index("practical <span") < opening.index("<figure")
    assert "<h2>The last seconds</h2>" not in html
    assert not re.search(r"<[^>]*(src|href)=|url\(|@import|https?://(?!github.com/leeoniya)", html)
    assert html.count("<script") == 2
    assert f"<script>{inlined_script()}</script>" in html


@pytest.mark.parametrize(
    ("fields", "clock", "drawn"),
    [
        ({"realtime": False}, "simulated time", False),
        ({"realtime": True}, "simulated time", False),
        ({"simulated": False}, "host time", True),
    ],
)
def test_lateness_is_shown_where_there_is_any(fields, clock, drawn, done):
    html = write_run_report(done.path, dataclasses.replace(done.record, **fields)).read_text()
    assert (LATENESS in titles(html)) is drawn
    # Without pacing, there is no table of a lateness that is always zero.
    assert ("there is no lateness to show" in html) is (fields == {"realtime": False})
    assert {data_of(html, k)["frame"]["clock"] for k in range(len(titles(html)))} == {clock}
    assert ("REAL BENCH" in html) is drawn


def test_a_histogram_of_an_edited_record_cannot_add_markup(done: RunFolder) -> None:
    part = done.record.parts[-1]
    answer = dict(part.timing["answer"])
    answer["edges_us"] = ["<script>x</script>"] * len(answer["edges_us"])
    parts = [dataclasses.replace(part, timing={**part.timing, "answer": answer})]
    record = dataclasses.replace(done.record, parts=parts)
    html = write_run_report(done.path, record).read_text()
    assert "&lt;script&gt;x" in html
    assert "<script>x" not in html


def test_a_run_waits_for_no_library_of_plots_tables_and_filters(short_sequence, tmp_path):
    code = (
        # python-can itself loads asammdf if it is installed.
        "import sys; sys.modules['asammdf'] = None\n"
        "import rig.cli.entry\n"
        "assert rig.cli.entry.status(['run', *sys.argv[1:], '--yes']) == 0\n"
        "print(sorted(sys.modules))"
    )
    arguments = [short_sequence, "--out", tmp_path / "out"]
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True
    )
    assert "'rig.results.run.charts'" in done.stdout
    assert "'can.io.mf4'" in done.stdout
    for heavy in ("matplotlib", "jinja2", "pandas", "scipy.signal", "scipy.special"):
        assert f"'{heavy}'" not in done.stdout


def test_a_stop_by_the_operator_marks_the_last_sample_of_the_excitation(runner, fake_bench):
    bench = fake_bench()

    def stop() -> None:
        raise KeyboardInterrupt

    bench.faults["exchange", INSIDE] = stop
    folder, _ = runner(bench)
    found = Recorded(folder.path, folder.record, 1)
    tail, moment = found.traces.tail, found.moment
    assert moment.words == "stopped"
    assert moment.time == tail.time[tail.segment == 1][-1]
    assert titles(last_part(page_of(folder)))[0] == "joint angle"


class GivesUp(AutomaticOperator):
    """Stops at the prompt for a weight of at least so many kg."""

    def __init__(self, least_kg: float) -> None:
        super().__init__()
        self.least_kg = least_kg

    def confirm_weight(self, stage: str, weight_kg: float) -> float:
        if weight_kg >= self.least_kg:
            raise OperatorStopError("stopped at the weight prompt")
        return weight_kg


def test_a_stop_while_the_drive_is_off_shows_when_it_last_had_power(runner, fake_bench):
    folder, _ = runner(fake_bench(), operator=GivesUp(1.0))
    assert data_of(page_of(folder), OPENING)["frame"]["mark"][1].startswith("last under power ")


def test_a_run_that_never_moved_says_so(runner: Any, fake_bench: Any) -> None:
    folder, _ = runner(fake_bench(), operator=GivesUp(0.0))
    html = page_of(folder)
    assert NEVER_MOVED in last_part(html)
    assert titles(html) == []
    assert f"rig resume {folder.path}" in html


def test_what_a_died_run_recorded_is_shown_once_it_is_recovered(runner, fake_bench, capsys):
    folder, _ = runner(fake_bench())
    content = folder.recording.read_bytes()
    folder.recording.write_bytes(content[: len(content) // 2])
    raw = json.loads((folder.path / "run.json").read_text())
    raw.update(state="running", message="", de_energised=None, drive_state=None)
    raw["parts"][0]["state"] = raw["stages"][0]["state"] = "running"
    (folder.path / "run.json").write_text(json.dumps(raw))
    assert status(["recover", str(folder.path)]) == 0
    first, go_on, page = capsys.readouterr().out.splitlines()[-3:]
    assert first == f"first: {NOT_READ_BACK}"
    assert go_on == f"go on with: rig resume {folder.path}"
    assert page == f"page: {folder.path / 'run.html'}"
    html = (folder.path / "run.html").read_text()
    frame = data_of(html, OPENING)["frame"]
    assert frame["mark"][1].startswith("recording ends ")
    assert frame["shades"][-1][2] == "not recorded"
    assert titles(last_part(html))[0] == "joint angle"


def test_each_recording_of_a_run_that_went_on_is_shown(runner: Any, fake_bench: Any) -> None:
    bench = fake_bench()
    bench.faults["exchange", INSIDE] = lambda: bench.overrides.update(current_A=26.0)
    folder, _ = runner(bench)
    first = dataclasses.replace(folder.record.parts[0], file="first.mcap")
    shutil.copy(folder.recording, folder.path / "first.mcap")
    folder.record.parts.insert(0, first)
    for segment in folder.record.segments:
        segment.part = 2
    html = page_of(folder)
    assert "<h2>Recording 1: first.mcap</h2>" in html
    assert "<h2>Recording 2: recording.mcap</h2>" in html
    # The trip was in the second.
    one, two = html.partition("<h2>Recording 1")[2].split("<h2>Recording 2")
    marks = [data_of(html, plot_of(part))["frame"]["mark"] for part in (one, two)]
    assert marks[0] is None
    assert marks[1][1].startswith("tripped 0.")


BRIEF = stages(sine("a", duration_s=0.3, more=", ramp_in_s: 0.1, ramp_out_s: 0.1, settle_s: 0.01"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RunRecord]:
    """A run that tripped, not to be changed."""
    folder = tmp_path_factory.mktemp("whole")
    path = folder / "short.yaml"
    path.write_text(BRIEF)
    faults = folder / "faults.yaml"
    faults.write_text(
        "faults: 1\nrows:\n  - {phase: excite, after_s: 0.1, target: encoder, fault: jump, value: "
        "5}\n"
    )
    assert (
        status(["run", str(path), "--yes", "--out", str(folder / "run"), "--faults", str(faults)])
        == 1
    )
    return folder / "run", read_record(folder / "run")


def broken(whole: tuple[Path, RunRecord], folder: Path, content: bytes | None) -> str:
    """Return the page of a run whose recording holds this instead; None for no recording."""
    folder.mkdir()
    if content is not None:
        (folder / "recording.mcap").write_bytes(content)
    return write_run_report(folder, whole[1]).read_text()


@pytest.mark.parametrize("content", [None, b"hello"])
def test_without_a_recording_the_rest_of_the_page_is_there(whole, tmp_path, content):
    html = broken(whole, tmp_path / "run", content)
    assert ("cannot be read" if content is None else "not an MCAP recording") in last_part(html)
    assert "encoder against drive" in html
    assert "rig resume" in html
    assert html.rstrip().endswith("</body></html>")


@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_whatever_the_recording_is_like_there_is_a_page(whole, tmp_path_factory, data):
    content = bytearray((whole[0] / "recording.mcap").read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at] ^= data.draw(st.integers(1, 255))
    cut = data.draw(st.integers(0, len(content)))
    html = broken(whole, tmp_path_factory.mktemp("torn") / "run", bytes(content[:cut]))
    assert "rig resume" in html
    assert html.rstrip().endswith("</body></html>")


def test_without_attached_files_the_limit_of_the_trip_alone_is_drawn(whole, monkeypatch, tmp_path):
    monkeypatch.setattr(recorded, "read_attachments", lambda attachments: read_attachments({}))
    html = broken(whole, tmp_path / "run", (whole[0] / "recording.mcap").read_bytes())
    assert "The limits are not known (bench.yaml is not attached to the recording)" in html
    first, _, rest = last_part(html).partition("</figure>")
    assert "limit -1 and 1 deg: BEYOND THE LIMIT" in first
    assert "sample by sample" in rest
    others = rest.partition("</figure>")[2]
    assert 'class="key limit"' not in others
    assert "limit not known" in others


@pytest.mark.parametrize("name", ["last_seconds", "whole", "read_attachments", "read_traces"])
def test_a_failure_in_drawing_leaves_the_rest_of_the_page(whole, tmp_path, monkeypatch, name):
    def fails(*arguments: Any) -> None:
        raise ZeroDivisionError("a defect of this page")

    for module in (report, charts, recorded):
        monkeypatch.setattr(module, name, fails, raising=False)
    html = broken(whole, tmp_path / "run", (whole[0] / "recording.mcap").read_bytes())
    assert "ZeroDivisionError: a defect of this page" in html
    assert "rig resume" in html
    assert "<h2>Provenance</h2>" in html


def test_the_limits_over_time_are_those_that_were_judged_by(runner, fake_bench, monkeypatch):
    """Every change of limits, first passes and the ways to them included, worked out from what is
    attached.
    """
    plan = make_plan(runner.inputs.sequence, runner.inputs.bench, first_pass=True)
    runner = dataclasses.replace(runner, plan=plan)
    used: list[tuple[float, Limits]] = []
    real = Cycle.use

    def use(self: Cycle, limits: Limits) -> None:
        used.append((self.next_s, limits))
        real(self, limits)

    monkeypatch.setattr(Cycle, "use", use)
    folder, _ = runner(fake_bench())
    traces = Recorded(folder.path, folder.record, 1).traces
    attached = read_attachments(traces.attachments)
    assert attached.plan is not None
    steps = limit_steps(attached.plan, traces.events, traces.starts)
    assert len(used) >= 6
    cycle_s = folder.record.cycle_s
    for time, limits in used:
        found = [step for step in steps if step[0] <= time + 0.5 * cycle_s][-1][1]
        assert dataclasses.replace(found, gas=None) == dataclasses.replace(limits, gas=None), time
        before = [step for step in steps if step[0] <= time - 2.5 * cycle_s][-1][1]
        assert before != limits, time


def attached_limits(bench: str, *warnings: str) -> Limits:
    """Return the limits of a run to which this bench and these warnings are attached."""
    run = json.dumps({"warnings": warnings}).encode()
    content = load_bench(bench).path.read_bytes()
    found = read_attachments({"bench.yaml": content, "run.json": run}).bench
    return found.limits


def test_the_limits_of_a_bench_without_a_watchdog_are_reduced() -> None:
    """The warnings of earlier versions begin with the same words."""
    assert attached_limits("practical_serial") == load_bench("practical_serial").value.limits
    plain = attached_limits("practical").torque_N_m
    for words in (NO_WATCHDOG, GUARDED, "this drive has no watchdog: x"):
        assert attached_limits("practical", words).torque_N_m < plain


@pytest.mark.parametrize("content", [b"\xff", b"a: [", b"bench: 2"])
def test_an_attached_bench_that_cannot_be_read_is_a_problem_in_words(content: bytes) -> None:
    attached = read_attachments({"bench.yaml": content})
    assert attached.bench is None
    assert "bench.yaml" in attached.problem


def taken(count: int, **fields: Any) -> dict[str, Array]:
    time = np.arange(count) * 1e-3
    found = {name: np.zeros(count) for name in Sample._fields}
    found |= {
        "time": time,
        "host_time": time + 4e-4,
        "device_time": time + 5.0,
        "encoder_time": 1.001 * time,
    }
    found |= {
        "fresh": np.ones(count),
        "statusword": np.full(count, 0x237),
        "pressure": np.full(count, math.nan),
    }
    return found | fields


def derived(count: int, **fields: Any) -> Callable[[str], Array]:
    """Return the channels, by name, that follow from so many samples."""
    values = Deriver(BENCH, 1e-3)(taken(count, **fields), []).values
    return lambda name: values[:, NAMES.index(name)]


BENCH = Bench(torque_constant=0.03, gear_ratio=100.0)


def test_derived_channels_are_those_of_the_safety_check() -> None:
    channel = derived(
        3, motor_angle=np.full(3, 10.0), angle=np.full(3, 0.09), current=np.full(3, -2.0)
    )
    np.testing.assert_allclose(channel("disagreement"), 0.01)
    np.testing.assert_allclose(channel("torque"), -6.0)
    np.testing.assert_allclose(channel("error"), -0.09)
    np.testing.assert_allclose(channel("answer"), 4e-4)
    np.testing.assert_allclose(channel("drive_clock"), 0.0, atol=1e-12)
    np.testing.assert_allclose(channel("encoder_clock"), [0.0, 1e-6, 2e-6], atol=1e-12)
    assert np.isnan(channel("pressure")).all()
    assert np.isnan(channel("force")).all()


def test_ages_go_on_from_block_to_block() -> None:
    whole = taken(10, fresh=np.array([1, 1, 0, 0, 1, 0, 0, 0, 1, 1.0]))
    for split in range(1, 9):
        derive, age = Deriver(BENCH, 1e-3), NAMES.index("age")
        parts = [
            {k: v[part] for k, v in whole.items()} for part in np.split(np.arange(10), [split])
        ]
        ages = np.concatenate([derive(part, []).values[:, age] for part in parts])
        np.testing.assert_allclose(1e3 * ages, [0, 0, 1, 2, 0, 1, 2, 3, 0, 0], atol=1e-9)


def test_the_state_of_the_drive() -> None:
    words = np.array([0x237, 0x217, 0x218, 0x21F, 0x250, 0x231])
    found = [STATES[int(state)] for state in derived(6, statusword=words)("state")]
    assert found == ["enabled", "quick stop", "fault", "fault", "off", "off"]


@pytest.mark.parametrize(("event", "at_s"), [("stage start", 0.050), ("stage end", 0.040)])
def test_a_step_of_time_is_lateness_but_for_a_pause(event: str, at_s: float) -> None:
    time = np.array([0.0, 1.0, 31.0, 32.0, 60.0, 61.0]) * 1e-3
    derived = Deriver(BENCH, 1e-3)(taken(6, time=time), [{"event": event, "time": at_s}])
    np.testing.assert_allclose(
        1e3 * derived.values[:, NAMES.index("late")], [0, 0, 29, 0, 0, 0], atol=1e-9
    )
    assert derived.broken.tolist() == [True, False, True, False, True, False]


EVENTS: list[dict[str, Any]] = [
    {"event": "prompt", "time": 0.0, "stage": "a"},
    {"event": "stage start", "time": 1.0, "stage": "a"},
    {"event": "segment", "time": 2.0, "stage": "a", "number": 1},
    {"event": "segment", "time": 5.0, "stage": "a", "number": 2},
    {"event": "stage end", "time": 7.0, "stage": "a"},
    {"event": "prompt", "time": 7.0, "stage": "b"},
    {"event": "stage start", "time": 20.0, "stage": "b"},
    {"event": "first pass", "time": 20.5, "stage": "b"},
    {"event": "weight check", "time": 21.0, "stage": "b"},
    {"event": "segment", "time": 22.0, "stage": "b", "number": 3},
    {"event": "tripped", "time": 24.0, "phase": "excite"},
]
SEGMENTS = [
    SegmentRecord(1, "a[1]", "unloaded", 0.0, 2.0, 2000, 4.0),
    SegmentRecord(2, "a[2]", "unloaded", 0.0, 5.0, 1900, 6.9),
    SegmentRecord(3, "b", "loaded", 10.0, 22.0, 9000),
]


def test_phases_follow_from_events_and_excitations() -> None:
    found = spans(EVENTS, SEGMENTS, 23.9)
    assert [(s.stage, s.phase, round(s.start, 6), round(s.stop, 6)) for s in found] == [
        ("a", MOVING, 1.0, 2.0),
        ("a[1]", "excite", 2.0, 4.0),
        ("a[1]", "hold", 4.0, 4.1),
        ("a[1]", MOVING, 4.1, 5.0),
        ("a[2]", "excite", 5.0, 6.9),
        ("a[2]", "hold", 6.9, 7.0),
        ("b", MOVING, 20.0, 20.5),
        ("b", "first pass", 20.5, 21.0),
        ("b", MOVING, 21.0, 22.0),
        ("b", "excite", 22.0, 23.9),
    ]


@settings(max_examples=25)
@given(count=st.integers(2, 9000), pause=st.sampled_from([0, 100_000]), seed=st.integers(0, 9))
def test_a_recording_is_reduced_without_the_loss_of_an_extreme(count, pause, seed):
    cycles, half = np.arange(count), count // 2
    cycles[half:] += pause
    current = np.random.default_rng(seed).normal(size=count)
    whole = taken(count, time=cycles * 1e-3, current=current)
    first, second = (
        Block({name: values[part] for name, values in whole.items()})
        for part in (slice(half), slice(half, None))
    )
    start = Happening({"event": "stage start", "time": float(whole["time"][half])})
    traces = _gathered([first, start, second], BENCH, 1e-3)
    assert traces.reduced.extremes("current") == (current.min(), current.max())
    assert len(traces.reduced.time) <= 2 * COLUMNS + 3
    assert (np.diff(traces.reduced.time) >= 0.0).all()
    ends = whole["time"][[0, half - 1, half, -1]].tolist()
    assert traces.powered == [tuple(ends[:2]), tuple(ends[2:])]
    # No line is drawn across a pause.
    row = traces.reduced.low[NAMES.index("current")]
    assert np.isnan(row).sum() == (1 if pause else 0)


def test_the_last_samples_have_gaps_and_keep_every_extreme() -> None:
    values = np.zeros((6000, len(NAMES)))
    values[1234, 0], values[4321, 0] = 7.0, -7.0
    broken = np.arange(6000) == 3000
    tail = Derived(np.arange(6000) * 1e-3, values, broken, np.zeros(6000))
    few, many = (Traces(tail=tail).samples(first, 6.0) for first in (4.3, 0.0))
    assert few.extremes(NAMES[0]) == (-7.0, 0.0)
    assert len(few.time) == 1700
    assert many.extremes(NAMES[0]) == (-7.0, 7.0)
    assert len(many.time) <= 2 * 2000
    assert np.isnan(many.low).any(axis=0).sum() == 1
    assert not np.isnan(few.low).any()


def current(*values: float) -> Series:
    matrix = np.full((len(NAMES), len(values)), math.nan)
    matrix[NAMES.index("current")] = values
    return Series(np.arange(len(values)) * 1e-3, matrix, matrix)


CURRENT = next(panel for panel in PANELS if Check.CURRENT in panel.checks)
AXIS = Frame(TimeAxis([(0.0, 1e-3)]), "")


def held(limit: Any, series: Series) -> Chart:
    """Return the chart of a current that is held against a limit, or against steps of limits."""
    steps = limit if isinstance(limit, list) else [(-math.inf, limit)]
    made = chart(
        dataclasses.replace(CURRENT, upper=lambda value: value), series, steps, None, tall=False
    )
    assert made is not None
    return made


def test_a_limit_is_written_with_what_is_beyond_it_and_drawn_if_it_is_near() -> None:
    for limit, shown in ((9.9, True), (10.0, True), (10.1, False)):
        made = held(limit, current(0.0, 1.0))
        assert bool(made.limits) is shown
        assert f"limit -{limit:g} and {limit:g} A" in made.reading
    for value, beyond in ((5.0, False), (5.001, True), (-5.0, False), (-5.001, True)):
        made = held(5.0, current(0.0, value))
        assert made.beyond is beyond
        assert ("BEYOND THE LIMIT" in Plots().figure(made, AXIS)) is beyond


def test_the_limit_of_a_trip_is_drawn_where_no_other_is_known() -> None:
    made = chart(CURRENT, current(0.0, -12.0), [], Tripped(Check.CURRENT, 12.0, 11.0), tall=True)
    assert sorted(limit[0][1] for limit in made.limits) == [-11.0, 11.0]
    assert made.beyond
    pressure = next(panel for panel in PANELS if Check.PRESSURE in panel.checks)
    assert chart(pressure, current(1.0), [], None, tall=False) is None


def plots_data(plots: Plots) -> Any:
    """Return the data of the charts as a browser reads them."""
    return json.loads(plots.script().partition(">")[2].removesuffix("</script>"))


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True, width=32), min_size=1, max_size=50))
def test_any_values_can_be_drawn(values: list[float]) -> None:
    plots = Plots()
    made = chart(CURRENT, current(*values), [], None, tall=False)
    if made is not None:
        plots.figure(made, Frame(TimeAxis([(0.0, 1.0)]), ""))
    assert "NaN" not in plots.script()
    assert "Infinity" not in plots.script()
    for each in plots_data(plots)["charts"]:
        assert each["range"][0] < each["range"][1]


@pytest.mark.parametrize("value", [60.0, -60.0, 0.0])
def test_the_axis_of_a_constant_is_close_about_it(value: float) -> None:
    made = chart(CURRENT, current(value, value), [], None, tall=False)
    low, high = made.range
    assert low < value < high
    assert high - low < 0.3 * abs(value) + 1e-5


@given(st.floats(1e-3, 1e5), st.floats(0.0, 1e3))
def test_the_ticks_of_the_time_are_round_numbers(total: float, start: float) -> None:
    ticks = list(TimeAxis([(start, start + total)]).ticks())
    assert 2 <= len(ticks) <= 6
    places, values = np.array([(place, float(label)) for place, label in ticks]).T
    (step,) = {float(f"{each:.3g}") for each in np.diff(values)}
    assert step == float(f"{step:.0e}"), "one digit"
    assert f"{step:.0e}"[0] in "125"
    np.testing.assert_allclose(np.rint(values / step) * step, values, rtol=1e-9, atol=1e-9)
    drawn = start + places * total
    np.testing.assert_allclose(drawn, values, rtol=0.0, atol=1e-6 * total + 1e-9)


def test_text_from_files_is_escaped() -> None:
    plots = Plots()
    panel = Panel("<t>", "<u>", 1.0, {"current": "<c>"})
    made = chart(panel, current(0.0, 1.0), [], None, tall=False)
    assert made is not None
    made = dataclasses.replace(made, reading="<r>")
    shades = [Shade(0.0, 1.0, "</script><s>", 0)]
    html = plots.figure(made, Frame(TimeAxis([(0.0, 1.0)]), "<k>", shades, (0.5, "<m>")))
    for name in "tucr":
        assert f"<{name}>" not in html
        assert f"&lt;{name}&gt;" in html
    assert "<" not in plots.script().removesuffix("</script>").partition(">")[2]
    assert plots_data(plots)["charts"][0]["frame"]["shades"][0][2] == "</script><s>"


def test_a_limit_that_changes_is_drawn_in_steps_and_judged_by_the_wider() -> None:
    plots = Plots()
    steps = [(-math.inf, 5.0), (0.5e-3, 3.0)]
    made = held(steps, current(4.0, 2.0))
    assert not made.beyond
    plots.figure(made, AXIS)
    upper, lower = plots_data(plots)["charts"][0]["limits"]
    assert upper == [[0.0, 0.5, 5.0], [0.5, 1.0, 3.0]]
    assert lower == [[0.0, 0.5, -5.0], [0.5, 1.0, -3.0]]
    late = current(4.0, 4.0)
    assert held(steps, late).beyond
    assert not held(steps, late._replace(width_s=1.5e-3)).beyond
