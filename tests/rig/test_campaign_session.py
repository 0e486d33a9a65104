"""Campaigns that say when recordings were made, which part counts, and what hangs on the joint."""

from pathlib import Path

import numpy as np
import pytest

from identification.recording import Hoist, Model, Pendulum, Recording
from identification.views.view import one_clock, run_starts
from rig.common.errors import InputError
from rig.sources import load_source

RATE = 100.0


def write(path: Path, seconds: float = 30.0, first: float = 0.0) -> None:
    time = first + np.arange(round(seconds * RATE)) / RATE
    angle = np.sin(2.0 * np.pi * 0.5 * time)
    torque = 3.0 * np.cos(2.0 * np.pi * 0.5 * time)
    table = np.column_stack([time, angle, torque])
    np.savetxt(path, table, delimiter=",", header="t,a,m", comments="", fmt="%.9g")


def campaign(folder: Path, recordings: str) -> Path:
    for name in ("a.csv", "b.csv", "c.csv"):
        if not (folder / name).exists():
            write(folder / name)
    path = folder / "c.yaml"
    path.write_text(
        "campaign: 1\nbench: {torque_constant: 1, moment_arm: 0.1, lever_ratio: 1}\n"
        f"defaults: {{channels: {{time: t, angle: a, torque: m}}}}\nrecordings:\n{recordings}\n"
    )
    return path


def load(folder: Path, recordings: str) -> tuple[Recording, ...]:
    return load_source(campaign(folder, recordings)).recordings


def problems(folder: Path, recordings: str) -> str:
    with pytest.raises(InputError) as caught:
        load(folder, recordings)
    return "\n".join(caught.value.problems)


def test_only_the_window_of_a_file_is_used(tmp_path: Path) -> None:
    a, b, c = load(
        tmp_path,
        "  - {file: a.csv, window: {from: 2.0, to: 3.0}}\n"
        "  - {file: b.csv, window: {from: 29}}\n"
        "  - {file: c.csv, window: [null, 1]}\n",
    )
    assert (a.time[0], a.time[-1], len(a.time)) == (2.0, 2.99, 100)
    assert (b.time[0], b.time[-1]) == (29.0, 29.99)
    assert (c.time[0], c.time[-1]) == (0.0, 0.99)
    assert "window 2 s to 3 s: 100 of 3000 samples used" in a.notes


def test_what_a_window_leaves_out_may_be_broken_and_rows_keep_their_place(tmp_path: Path) -> None:
    write(tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    for row in range(1, 200):
        lines[row] = lines[row].split(",")[0] + ",nan,nan"
    lines[1001] = lines[1500]  # From there time runs back, on line 1003.
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    (a,) = load(tmp_path, "  - {file: a.csv, window: [2, 9]}\n")
    assert len(a.time) == 700
    text = problems(tmp_path, "  - {file: a.csv, window: [2, 20]}\n")
    assert "a.csv:1003: time runs backwards" in text


def test_windows_of_one_file_may_not_overlap(tmp_path: Path) -> None:
    fit, score = load(
        tmp_path,
        "  - {file: a.csv, window: [null, 20]}\n"
        "  - {file: a.csv, window: [20, null], role: validate}\n",
    )
    assert len(fit.time) + len(score.time) == 3000
    text = problems(
        tmp_path,
        "  - {file: a.csv, window: [0, 20]}\n  - {file: a.csv, window: [19, 30], role: validate}\n",
    )
    assert "used both to fit and to validate" in text


def test_iso_times_make_a_common_clock(tmp_path: Path) -> None:
    a, b, c = load(
        tmp_path,
        "  - {file: a.csv, start: '2026-05-04T10:20:00+02:00'}\n"
        "  - {file: b.csv, start: 2026-05-04T08:00:00Z, window: [10, null]}\n"
        "  - {file: c.csv, start: 2026-05-04 08:10:00, role: validate}\n",
    )
    assert (a.start, b.start, c.start) == (1200.0, 10.0, 600.0)
    assert run_starts([a, b, c]) == [1200.0, 10.0, 600.0]
    assert "begins 1200 s into the session" in a.notes


def test_each_session_starts_cold_on_a_clock_of_its_own() -> None:
    def recorded(session: str, *starts: float) -> list[Recording]:
        t = np.linspace(0.0, 20.0, 101)
        return [Recording(t + s, np.sin(t), torque=np.cos(t), session=session) for s in starts]

    first, second, alone = recorded("a", 1.0, 31.0), recorded("b", 2.0, 52.0), recorded("c", 3.0)
    every = [*first, *second, *alone]
    assert one_clock(every)
    assert run_starts(every) == pytest.approx([1.0, 31.0, 2.0, 52.0, 3.0])
    assert run_starts([*recorded("", 1.0, 31.0), *recorded("", 2.0)]) == [0.0] * 3


@pytest.mark.parametrize(
    ("recordings", "words"),
    [
        (
            "  - {file: a.csv, start: 0}\n  - {file: b.csv}\n",
            "no `start`, but the first recording has `start` in seconds",
        ),
        (
            "  - {file: a.csv, start: 0}\n  - {file: b.csv, start: 2026-05-04T08:00:00}\n",
            "`start` as an ISO time, but the first recording has `start` in seconds",
        ),
        ("  - {file: a.csv, start: 2026-05-04}\n", "not an ISO time with date and time of day"),
        ("  - {file: [a.csv, b.csv], start: 0}\n", "one `start` for 2 files"),
        ("  - {file: a.csv, start: 0}\n  - {file: b.csv, start: 10}\n", "before a ends at 29.99 s"),
    ],
)
def test_clocks_that_cannot_be_are_refused(tmp_path: Path, recordings: str, words: str) -> None:
    text = problems(tmp_path, recordings)
    assert words in text
    assert "c.yaml:5:" in text or "c.yaml:6:" in text


TABLE = """\
# made by hand
file;gravity.mass;gravity.length;role;start;window.from
a.csv;0.5;0.1;;0;
b.csv;0.7;0.15;validate;100;20
c.csv;;;;200;
"""


def test_a_table_is_as_many_recordings_as_it_has_rows(tmp_path: Path) -> None:
    (tmp_path / "files.csv").write_text(TABLE)
    for text in ("  table: files.csv\n", "  - table: files.csv\n"):
        a, b, c = load(tmp_path, text)
        assert (a.pendulum, b.pendulum, c.pendulum) == (
            Pendulum(0.5, 0.1),
            Pendulum(0.7, 0.15),
            None,
        )
        assert (a.role, b.role, c.role) == ("fit", "validate", "fit")
        assert (a.start, b.start, b.time[0]) == (0.0, 120.0, 20.0)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("file,gravty.mass\na.csv,1\n", "files.csv:1:6: recordings[0].gravty"),
        ("file,role\na.csv\n", "files.csv:2:1: recordings.table: 1 cells under 2 columns"),
        ("file,file\na.csv,b.csv\n", "two columns are named 'file'"),
        (
            "file,gravity,gravity.mass\na.csv,1,2\n",
            "one column names the key 'gravity', and another",
        ),
        ("file\nnone.csv\n", "files.csv:2:1: recordings[0].file: no such file"),
    ],
)
def test_errors_of_a_table_have_their_place_in_it(tmp_path: Path, table: str, words: str) -> None:
    (tmp_path / "files.csv").write_text(table)
    assert words in problems(tmp_path, "  table: files.csv\n")


def test_known_loads_reach_the_recording(tmp_path: Path) -> None:
    a, b = load(
        tmp_path,
        "  - {file: a.csv, hoisted: {mass: 2, radius: 0.05}}\n"
        "  - {file: b.csv, constant_torque: -0.4}\n",
    )
    assert a.hoist == Hoist(2.0, 0.05)
    assert a.steady_torque == pytest.approx(-2.0 * 9.80665 * 0.05)
    assert b.steady_torque == -0.4
    assert any("hoisted 2 kg: -0.9807 N m on the joint" in note for note in a.notes)
    assert any("known constant torque -0.4 N m on the joint" in note for note in b.notes)


def test_loads_that_cannot_be_are_refused(tmp_path: Path) -> None:
    assert "no `radius`" in problems(tmp_path, "  - {file: a.csv, hoisted: {mass: 2}}\n")
    path = campaign(tmp_path, "  - {file: a.csv, hoisted: {mass: 2, radius: 0.1}}\n")
    text = path.read_text()
    for bench, words in (
        ("bench: {motion: linear, torque_constant: 1}", "remove `radius`"),
        ("bench: {}", "no use in a fit in amperes"),
    ):
        head, _, rest = text.partition("bench: ")
        changed = f"{head}{bench}\n{rest.partition(chr(10))[2]}".replace("torque: m", "current: m")
        path.write_text(changed)
        with pytest.raises(InputError, match=words):
            load_source(path)


def test_a_pendulum_has_no_use_in_a_fit_in_amperes(tmp_path: Path) -> None:
    path = campaign(tmp_path, "  - {file: a.csv, gravity: {mass: 0.457, length: 0.1}}\n")
    head, _, rest = path.read_text().partition("bench: ")
    text = f"{head}bench: {{}}\n{rest.partition(chr(10))[2]}".replace("torque: m", "current: m")
    path.write_text(text)
    with pytest.raises(InputError, match="no use in a fit in amperes"):
        load_source(path)


def test_uncertain_constants_reach_the_recordings_and_fixed_values_become_priors(tmp_path):
    path = campaign(
        tmp_path,
        "  - {file: a.csv, gravity: {mass: {value: 2, std: 0.1}, length: 0.1,"
        " zero: {value: -0.2, std: 0.05}}}\n"
        "  - {file: b.csv, stage: loaded, weight_mass: {value: 10.2, std: 0.05}}\n",
    )
    path.write_text(
        path.read_text().replace(
            "bench: {torque_constant: 1,",
            "model: {fixed: {Mc: {value: 5, std: 0.5}, J: 0.2}}\n"
            "bench: {torque_constant: {value: 1, std: 0.1},",
        )
    )
    dataset = load_source(path)
    a, b = dataset.recordings
    assert a.uncertainties == {
        "bench.torque_constant": 0.1,
        "pendulum.mass": 0.1,
        "pendulum.zero": 0.05,
    }
    assert b.uncertainties == {"bench.torque_constant": 0.1, "weight_mass": 0.05}
    assert (a.bench.torque_constant, b.weight_mass) == (1.0, 10.2)
    assert a.pendulum == Pendulum(2.0, 0.1, -0.2)
    assert dataset.model == Model(fixed={"J": 0.2}, priors={"Mc": (5.0, 0.5)})


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("{value: 2, std: 2}", "is not below the value 2"),
        ("{value: 2, uncertainty: 0.1}", "unknown key; known are"),
        ("{value: 0, std: 0.1}", "input should be greater than 0"),
    ],
)
def test_uncertain_constants_that_cannot_be_are_refused(tmp_path, value, words):
    text = problems(tmp_path, f"  - {{file: a.csv, gravity: {{mass: {value}, length: 0.1}}}}\n")
    assert words in text
    assert "recordings[0].gravity.mass" in text
