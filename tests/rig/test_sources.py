"""Campaigns on synthetic files: what is mended and noted, what is refused and where."""

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from identification.recording import Array, Recording
from rig.common.errors import InputError
from rig.sources import load_source

N = 2000
PERIOD = 0.001
Columns = dict[str, Array]


def motion() -> Columns:
    """A sine of 1 Hz driven against viscous friction; torque in N m."""
    time = np.arange(N) * PERIOD
    angle = np.sin(2 * np.pi * time)
    velocity = 2 * np.pi * np.cos(2 * np.pi * time)
    return {"t": time, "a": angle, "w": velocity, "m": 3.0 * velocity}


def write_csv(path: Path, columns: Columns) -> None:
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")


CHANNELS = "{time: t, angle: a, torque: m}"


def campaign(folder: Path, *recordings: str, extra: str = "") -> Path:
    path = folder / "campaign.yaml"
    listed = "".join(f"  - {item}\n" for item in recordings or ("file: a.csv",))
    path.write_text(
        f"campaign: 1\nbench: {{moment_arm: 0.1}}\ndefaults: {{channels: "
        f"{CHANNELS}}}\nrecordings:\n{listed}{extra}"
    )
    return path


def load(
    folder: Path, change: Callable[[Columns], object], *recordings: str
) -> tuple[Recording, ...]:
    columns = motion()
    change(columns)
    write_csv(folder / "a.csv", columns)
    return load_source(campaign(folder, *recordings)).recordings


def problems(folder: Path, change: Callable[[Columns], object], *recordings: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        load(folder, change, *recordings)
    return list(caught.value.problems)


def put(name: str, rows: slice | list[int], value: float) -> Callable[[Columns], object]:
    def change(columns: Columns) -> None:
        columns[name][rows] = value

    return change


def nothing(columns: Columns) -> None:
    del columns


def test_a_clean_file_is_passed_through(tmp_path: Path) -> None:
    (recording,) = load(tmp_path, nothing)
    assert recording.notes == ()
    assert recording.name == "a"
    assert recording.sha256 == hashlib.sha256((tmp_path / "a.csv").read_bytes()).hexdigest()
    np.testing.assert_allclose(recording.channels["torque"], motion()["m"], rtol=1e-8)
    assert set(recording.channels) == {"time", "angle", "torque"}


def test_scale_offset_rate_and_average(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv", motion())
    item = (
        "{file: a.csv, stage: loaded, weight_mass: 30.6, rate: 500, "
        "channels: {angle: {scale: 2, column: a, offset: 0.5}, torque: {average: true, column: 3}}}"
    )
    path = campaign(tmp_path, item)
    path.write_text(
        path.read_text()
        .replace("{moment_arm: 0.1}", "{moment_arm: 0.1, lever_ratio: 10}")
        .replace("time: t, ", "")
        .replace("angle: a, torque: m", "angle: {column: a}, torque: {column: m}")
    )
    (recording,) = load_source(path).recordings
    np.testing.assert_allclose(recording.channels["angle"], 2 * motion()["a"] + 0.5, atol=1e-8)
    np.testing.assert_array_equal(recording.time, np.arange(N) / 500)
    assert recording.averaged == {"torque"}
    assert recording.contact_force == pytest.approx(10 * 30.6 * 9.80665)


def test_missing_column_lists_what_is_there(tmp_path: Path) -> None:
    lines = problems(
        tmp_path, nothing, "{file: a.csv, channels: {angle: aa, velocity: 9, torque: zzz}}"
    )
    assert len(lines) == 3
    assert lines[0].startswith(
        f"{tmp_path}/campaign.yaml:5:37: recordings[0].channels.angle: no such column in "
    )
    assert "did you mean 'a'? columns are t, a, w, m (got \"aa\")" in lines[0]
    assert "recordings[0].channels.torque: no such column in" in lines[1]
    assert lines[1].endswith('columns are t, a, w, m (got "zzz")')
    assert "has 4 columns, index 0 to 3 (got 9)" in lines[2]


def test_several_bad_channels_and_files_are_all_reported(tmp_path: Path) -> None:
    write_csv(tmp_path / "b.csv", {**motion(), "t": np.full(N, np.nan)})

    def change(columns: Columns) -> None:
        columns["a"][50:100] = np.nan
        columns["m"][60:100] = np.nan

    lines = problems(tmp_path, change, "file: a.csv", "file: b.csv", "file: c.csv")
    assert len(lines) == 4
    assert [line.split(": ")[0] for line in lines[1:]] == [
        f"{tmp_path}/a.csv:52",
        f"{tmp_path}/a.csv:62",
        f"{tmp_path}/b.csv:2",
    ]
    assert "recordings[2].file: no such file in" in lines[0]


def repeat(count: int) -> Callable[[Columns], object]:
    def change(columns: Columns) -> None:
        rows = 1 + 2 * np.arange(count)
        columns["t"][rows] = columns["t"][rows - 1]

    return change


def shift(*starts: int) -> Callable[[Columns], object]:
    def change(columns: Columns) -> None:
        for start in starts:
            columns["t"][start:] += 1.0

    return change


def times(name: str, factor: float) -> Callable[[Columns], object]:
    return lambda columns: columns.update({name: factor * columns[name]})


def geared(factor: float) -> Callable[[Columns], object]:
    return lambda columns: columns.update(w=factor * columns["a"])


def inertial(columns: Columns) -> None:
    columns["m"] = -20 * columns["a"] - 0.2 * columns["w"]


def shuffled(columns: Columns) -> None:
    columns["a"] = np.random.default_rng(1).permutation(columns["a"])


def sparse(columns: Columns) -> None:
    columns["w"] = np.where(np.arange(N) % 100 == 0, 20 + columns["t"], np.nan)


def power_off(columns: Columns) -> None:
    columns["on"] = np.ones(N)
    columns["on"][500:900] = 0
    columns["u"] = columns["m"].copy()
    columns["u"][500:900] = columns["u"][1200] = np.nan


def power_unknown(columns: Columns) -> None:
    power_off(columns)
    columns["on"][3] = np.nan


MOTOR = "{file: a.csv, channels: {motor_angle: {column: w, scale: 1}}}"
HOT = "{file: a.csv, channels: {temperature: w}}"
SPEED = "{file: a.csv, channels: {velocity: w}}"
VOLTAGE = "{file: a.csv, channels: {voltage: u}}"
SWITCHED = "{file: a.csv, channels: {voltage: u, enabled: 'on'}}"
PLAIN = "file: a.csv"


@pytest.mark.parametrize(
    ("change", "item", "notes"),
    [
        (put("a", [10, 11, 500, N - 1], np.nan), PLAIN, ["`angle`: 4 missing samples"]),
        (put("m", slice(0, N, 20), np.inf), PLAIN, ["`torque`: 100 missing samples interpolated"]),
        (sparse, HOT, ["`temperature`: 1980 missing samples interpolated"]),
        (power_off, SWITCHED, ["`voltage`: 1 missing samples interpolated"]),
        (repeat(20), PLAIN, ["20 samples with a repeated time stamp dropped"]),
        (times("t", 0.49 / PERIOD), PLAIN, []),
        (times("t", 0.5 / PERIOD), PLAIN, ["median period 0.5 s: if `time` is in ms (2000 Hz)"]),
        (put("w", slice(None), 21.0), HOT, ["`temperature` is constant (21)"]),
        (geared(1.04), MOTOR, []),
        (geared(1.06), MOTOR, ["motor_angle / angle is 1.06, bench.gear_ratio is 1"]),
        (inertial, PLAIN, []),
        (times("m", -1), "{file: a.csv, channels: {torque: {column: m, scale: -1}}}", []),
        (times("m", -1), "{file: a.csv, gravity: {mass: 1, length: 1}}", []),
    ],
)
def test_what_is_mended_or_doubted_is_noted(tmp_path, change, item, notes):
    (recording,) = load(tmp_path, change, item)
    assert len(recording.notes) == len(notes)
    assert all(map(str.startswith, recording.notes, notes))


@pytest.mark.parametrize(
    ("change", "item", "place", "words"),
    [
        (put("t", [1000], 0.5), PLAIN, ":1002", "time runs backwards, from 0.999 to 0.5 s"),
        (put("m", slice(100, 106), np.nan), PLAIN, ":102", "`torque`: 6 of 2000 samples"),
        (put("m", slice(0, N, 19), np.inf), PLAIN, ":2", "`torque`: 106 of 2000 samples"),
        (repeat(21), PLAIN, ":3", "21 repeated time stamps (1.1 % of the rows, at most 1 %)"),
        (shift(*range(40, N, 40)), PLAIN, ":42", "49 gaps leave no span of 50 samples"),
        (power_off, VOLTAGE, ":502", "`voltage`: 401 of 2000 samples are missing"),
        (power_unknown, SWITCHED, ":5", "`enabled` is missing in 1 rows"),
        (times("m", -1), PLAIN, "", "`torque` opposes the motion (correlation -1.00"),
        (times("w", -1), SPEED, "", "`velocity` runs against `angle` (correlation -1.00)"),
        (geared(-1), MOTOR, "", "`motor_angle` runs against `angle`"),
        (shuffled, PLAIN, "", "`angle` jumps from sample to sample"),
    ],
)
def test_what_cannot_be_used_is_refused_with_its_line(tmp_path, change, item, place, words):
    assert problems(tmp_path, change, item)[0].startswith(f"{tmp_path}/a.csv{place}: {words}")


@pytest.mark.parametrize(("rows", "told"), [(slice(100, 106), True), (slice(0, N, 19), False)])
def test_a_long_gap_of_a_channel_is_left_out_by_a_window(tmp_path, rows, told):
    assert ("`window`" in problems(tmp_path, put("m", rows, np.nan))[0]) is told


def test_what_is_mended_is_near_the_truth(tmp_path: Path) -> None:
    (recording,) = load(tmp_path, put("a", [10, 11, 500, N - 1], np.nan))
    np.testing.assert_allclose(recording.channels["angle"], motion()["a"], atol=0.01)
    (recording,) = load(tmp_path, repeat(20))
    assert len(recording.time) == N - 20
    truth = np.sin(2 * np.pi * recording.time)
    np.testing.assert_allclose(recording.channels["angle"], truth, atol=1e-6)
    (recording,) = load(tmp_path, sparse, HOT)
    heat = recording.channels["temperature"][:1901]
    np.testing.assert_allclose(heat, 20 + recording.time[:1901])
    voltage = load(tmp_path, power_off, SWITCHED)[0].channels["voltage"]
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(voltage)), np.arange(500, 900))


def test_gaps_split_and_short_spans_go(tmp_path: Path) -> None:
    first, second = load(tmp_path, shift(600, 649))
    assert (first.name, second.name) == ("a[1]", "a[2]")
    assert (len(first.time), len(second.time)) == (600, N - 649)
    assert first.notes == second.notes
    assert first.notes == (
        "2 gaps, the longest 1.001 s: split into 3 spans",
        "1 spans shorter than 50 samples dropped (49 samples)",
    )
    assert [r.name for r in load(tmp_path, shift(600, 650))] == ["a[1]", "a[2]", "a[3]"]


def test_a_joint_at_rest_tells_nothing_of_signs(tmp_path: Path) -> None:
    def flickering(columns: Columns) -> None:
        """Let two encoders flicker between three counts, by chance against each other."""
        rng = np.random.default_rng(4)
        joint, other = rng.integers(-1, 2, (2, N))
        columns["a"] = 1e-4 * joint
        columns["w"] = 1e-4 * np.where(rng.uniform(size=N) < 0.3, -joint, other)

    assert "motor_angle" in load(tmp_path, flickering, MOTOR)[0].channels


def test_globs_names_and_roles(tmp_path: Path) -> None:
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        write_csv(tmp_path / folder / "a.csv", motion())
        write_csv(tmp_path / folder / f"b[{folder}].csv", motion())
    data = load_source(
        campaign(
            tmp_path, "file: '*/a.csv'", "{file: ['one/b[one].csv', 'two/b*'], role: validate}"
        )
    )
    assert [r.name for r in data.part("fit")] == ["one/a", "two/a"]
    assert [r.name for r in data.part("validate")] == ["b[one]", "b[two]"]
    with pytest.raises(
        InputError, match=r"recordings\[1\]\.file: .*one/a\.csv is used both to fit and to validate"
    ):
        load_source(campaign(tmp_path, "file: '*/a.csv'", "{file: one/a.csv, role: validate}"))
    with pytest.raises(
        InputError,
        match=r"recordings\[0\]\.file: no file matches this pattern in .* \(got \"\*\.mat\"\)",
    ):
        load_source(campaign(tmp_path, "file: '*.mat'"))
    with pytest.raises(InputError, match=r"one is a folder"):
        load_source(campaign(tmp_path, "file: one"))


def test_sources_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"the folder has no run\.json"):
        load_source(tmp_path)
    (tmp_path / "a.csv").write_text("1,2\n")
    with pytest.raises(InputError, match="describe recordings made elsewhere in a campaign file"):
        load_source(tmp_path / "a.csv")
    with pytest.raises(
        InputError, match=r"no such file; a source is a run folder or a campaign file$"
    ):
        load_source(tmp_path / "b.mcap")


def test_arrays_of_different_length(tmp_path: Path) -> None:
    columns = motion()
    scipy.io.savemat(tmp_path / "a.mat", {**columns, "m": columns["m"][:-1]})
    with pytest.raises(
        InputError, match=r"channels differ in length: time 2000, angle 2000, torque 1999"
    ):
        load_source(campaign(tmp_path, "file: a.mat"))


def test_rows_of_an_array_file_are_counted_from_one(tmp_path: Path) -> None:
    columns = motion()
    columns["t"][4] = 0
    np.savez(tmp_path / "a.npz", **columns)
    with pytest.raises(InputError, match=r"a\.npz: row 5: time runs backwards"):
        load_source(campaign(tmp_path, "file: a.npz"))


@pytest.mark.parametrize(("samples", "refused"), [(50, False), (49, True)])
def test_the_shortest_recording(tmp_path: Path, samples: int, refused: bool) -> None:
    write_csv(tmp_path / "a.csv", {name: values[:samples] for name, values in motion().items()})
    if refused:
        with pytest.raises(InputError, match="only 49 samples; at least 50 are needed"):
            load_source(campaign(tmp_path))
    else:
        assert len(load_source(campaign(tmp_path)).recordings[0].time) == samples


def test_a_file_is_not_counted_twice(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv", motion())
    with pytest.raises(
        InputError, match=r"recordings\[1\]\.file: .*a\.csv is used twice; keep one entry"
    ):
        load_source(campaign(tmp_path, "file: a.csv", "file: './a.csv'"))
    both = campaign(
        tmp_path, "file: a.csv", "{file: a.csv, channels: {torque: {column: m, scale: 2}}}"
    )
    assert (
        len(load_source(both).recordings) == 2
    )  # another column, another scale: another axis of one log
