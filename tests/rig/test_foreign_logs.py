"""Logs as other people's tools write them, and broken ones: read with a word, or refused."""

import gzip
import importlib
import json
import struct
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from identification.recording import Recording
from rig.common.errors import InputError
from rig.config.campaign_sections import ReadSection
from rig.sources import load_source
from rig.sources.channels import starts_again
from rig.sources.formats import open_table
from rig.sources.look import look_at_file
from rig.sources.table import Table
from tests.rig.formats.campaigns import ANGLE, CURRENT, TIME, N, load_file

PLAIN = ReadSection()
BENCH = "campaign: 1\nbench: {torque_constant: 0.03, gear_ratio: 100, moment_arm: 0.095}\n"
CHANNELS = "{time: t, current: i, motor_angle: m, angle: q}"
NAMES = ("t", "i", "m", "q")
TRUTH = np.column_stack([TIME, CURRENT, 100.0 * ANGLE, ANGLE])


def rows_of(values: np.ndarray = TRUTH) -> list[list[str]]:
    return [[repr(float(v)) for v in row] for row in values]


def lines_of(delimiter: str = ",", values: np.ndarray = TRUTH) -> list[str]:
    return [delimiter.join(row) for row in rows_of(values)]


def load(folder: Path, text: str | bytes, channels: str = CHANNELS, read: str = "{}") -> Recording:
    (folder / "log.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_file(folder, "log.csv", channels, read)


def is_truth(recording: Recording) -> None:
    np.testing.assert_array_equal(recording.channels["current"], CURRENT)
    np.testing.assert_array_equal(recording.channels["angle"], ANGLE)
    np.testing.assert_array_equal(recording.channels["motor_angle"], 100.0 * ANGLE)
    np.testing.assert_allclose(recording.time - recording.time[0], TIME, rtol=0, atol=1e-12)


HEAD = "t,i,m,q\n"


@pytest.mark.parametrize(
    ("text", "note"),
    [
        (HEAD + "s,A,rad,rad\n" + "\n".join(lines_of()), "read as units: s, A, rad, rad"),
        ((HEAD + "\n".join(lines_of())).encode("utf-16"), "text in UTF-16"),
        ("\ufeff" + HEAD + "\n".join(lines_of()), None),
        (HEAD + "\n".join(lines_of()) + "\nEOF,,,\n", "(EOF) read as the end"),
        (HEAD + "\n".join(lines_of()) + "\n,,,\n", "1 rows without values at the end dropped"),
        ("t i m q\n" + "\n".join(lines_of("   ")), "columns separated by blanks"),
        ("t,i,m,q,\n" + "\n".join(lines_of()), "fewer cells than the first line"),
        (
            '"t"\t"i"\t"m"\t"q"\n'
            + "\n".join(f'"{k}"\t{line}' for k, line in enumerate(lines_of("\t"), 1)),
            "the first cell of each row is a row name",
        ),
    ],
)
def test_what_a_text_file_is_comes_out_and_is_said(tmp_path, text, note):
    recording = load(tmp_path, text)
    is_truth(recording)
    assert [n for n in recording.notes if note and note in n] or note is None
    assert len(recording.notes) == (note is not None)


def test_a_byte_order_mark_without_a_header_is_no_cell(tmp_path: Path) -> None:
    channels = "{time: 0, current: 1, motor_angle: 2, angle: 3}"
    is_truth(load(tmp_path, "\ufeff" + "\n".join(lines_of()), channels))


def test_a_pattern_in_a_folder_with_brackets(tmp_path: Path) -> None:
    folder = tmp_path / "data [old]"
    folder.mkdir()
    (folder / "log.csv").write_text(HEAD + "\n".join(lines_of()))
    is_truth(load_file(folder, "'*.csv'", CHANNELS, "{}"))


def test_dates_with_and_without_an_offset_are_seconds(tmp_path: Path) -> None:
    stamps = np.datetime64("2026-02-28T23:59:59.900", "us") + (TIME * 1e6).round().astype(int)
    for suffix in ("", "+01:00"):
        lines = [f"{s}{suffix},{row.split(',', 1)[1]}" for s, row in zip(stamps, lines_of())]  # noqa: B905
        recording = load(tmp_path, HEAD + "\n".join(lines))
        is_truth(recording)
        assert any("holds dates: read as seconds since 2026-02-28T" in n for n in recording.notes)


def test_times_of_day_go_on_after_midnight(tmp_path: Path) -> None:
    seconds = (86399.9 + TIME) % 86400
    cells = [f"{int(s) // 3600:02}:{int(s) // 60 % 60:02}:{s % 60:09.6f}" for s in seconds]
    lines = [f"{cell},{row.split(',', 1)[1]}" for cell, row in zip(cells, lines_of(), strict=True)]
    recording = load(tmp_path, HEAD + "\n".join(lines))
    np.testing.assert_allclose(recording.time, 86399.9 + TIME, atol=1e-9)
    assert any("starts again after one day" in note for note in recording.notes)


def test_a_windows_nan_is_missing_and_does_not_end_its_row(tmp_path: Path) -> None:
    lines = lines_of()
    cells = lines[100].split(",")
    lines[100] = ",".join([cells[0], "-1.#IND", *cells[2:]])
    recording = load(tmp_path, HEAD + "\n".join(lines))
    np.testing.assert_array_equal(recording.channels["angle"], ANGLE)
    assert abs(recording.channels["current"][100] - CURRENT[100]) < 0.05
    assert any("-1.#IND read as missing" in note for note in recording.notes)


def test_rows_of_another_topic_are_dropped_and_counted(tmp_path: Path) -> None:
    lines = []
    for row in rows_of():
        lines += [",".join([*row, ""]), f"{float(row[0]) + 4e-4!r},,,,1.0"]
    recording = load(tmp_path, "t,i,m,q,other\n" + "\n".join(lines))
    is_truth(recording)
    assert recording.notes == (
        "300 rows dropped that contain only a time, probably rows of another topic",
    )


def test_channels_of_two_topics_are_named(tmp_path: Path) -> None:
    lines = []
    for t, i, m, q in rows_of():
        lines += [f"{t},{i},,", f"{float(t) + 4e-4!r},,{m},{q}"]
    with pytest.raises(
        InputError, match=r"`current`: 300 of 600 .*has no row in common with `motor_angle`"
    ):
        load(tmp_path, HEAD + "\n".join(lines))


@pytest.mark.parametrize("where", [0, 7, N - 1])
def test_a_cell_more_than_names_is_never_read_shifted(tmp_path: Path, where: int) -> None:
    rows = rows_of()
    wrong = rows if where == 0 else [rows[where]]
    for row in wrong:
        row.insert(1, "0")
    with pytest.raises(
        InputError, match=rf"log\.csv:{where + 2}: 5 cells, but 4 names in the head"
    ):
        load(tmp_path, HEAD + "\n".join(",".join(row) for row in rows))


def test_a_first_line_that_counts_is_a_header(tmp_path: Path) -> None:
    channels = "{time: 0, current: 1, motor_angle: 2, angle: 3}"
    recording = load(tmp_path, "0,1,2,3\n" + "\n".join(lines_of()), channels)
    is_truth(recording)
    assert "numbers the columns from 0 to 3" in recording.notes[0]
    table = tmp_path / "two.csv"
    table.write_text("0,1\n1,2\n2,3\n")
    np.testing.assert_array_equal(open_table(table, PLAIN).read([0])[0], [0, 1, 2])


@pytest.mark.parametrize(("bits", "signed"), [(8, True), (18, False), (32, True)])
def test_a_position_counter_through_its_end(tmp_path: Path, bits: int, signed: bool) -> None:
    amplitude = 2.0 ** (bits - 1)
    counts = np.rint(amplitude * np.sin(12.0 * TIME))
    stored = np.mod(counts + amplitude * signed, 2.0**bits) - amplitude * signed
    if signed:
        stored = np.mod(counts + 2 * amplitude, 2.0**bits) - amplitude
        counts = counts + amplitude
    scale = 0.5 / amplitude
    values = np.column_stack([TIME, CURRENT, stored, ANGLE])
    channels = (
        f"{{time: t, current: i, motor_angle: {{column: m, scale: {scale * 100}}}, angle: q}}"
    )
    recording = load(tmp_path, HEAD + "\n".join(lines_of(",", values)), channels)
    steps = np.diff(recording.channels["motor_angle"])
    np.testing.assert_allclose(steps, np.diff(counts) * scale * 100, atol=1e-9)
    assert any(f"`motor_angle`: a counter of {bits} bits" in note for note in recording.notes)


LONG = np.arange(2500) * 1e-3
TURNS = [2 * np.pi, 1.0, 360.0, 500.0, 1000.0, 3600.0, 4000.0, 8000.0, 10000.0, 65000.0]


def turning(turn: float, zero: float, per_turn: float, noise: float = 0.0) -> np.ndarray:
    """Return a log of an angle that starts again after a turn: time, current, angle, true angle."""
    true = turn * (per_turn * np.sin(5.0 * LONG) + 0.31 * LONG + noise)
    stored = np.mod(true + zero * turn, turn) - zero * turn
    if turn >= 500.0:
        stored = np.floor(stored)
    current = 2.0 * np.cos(5.0 * LONG)
    return np.column_stack([LONG, current, stored, true])


def load_turning(folder: Path, values: np.ndarray, key: str = "") -> Recording:
    text = "t,i,q\n" + "\n".join(lines_of(",", values[:, :3]))
    return load(folder, text, f"{{time: t, current: i, angle: {{column: q{key}}}}}")


@pytest.mark.parametrize(
    ("turn", "zero", "per_turn"),
    [(t, 0.5 * (k % 2), (0.7, 6.3, 55.0)[k % 3]) for k, t in enumerate(TURNS)],
)
def test_an_angle_that_starts_again_is_asked_for_and_continued(tmp_path, turn, zero, per_turn):
    values = turning(turn, zero, per_turn)
    with pytest.raises(InputError, match="it starts again after a turn; state the turn") as refused:
        load_turning(tmp_path, values)
    asked = str(refused.value).split("wraps_after: ")[1].split("}")[0]
    assert float(asked) == pytest.approx(turn, rel=2e-3)
    assert "negate" not in str(refused.value)
    found = load_turning(tmp_path, values, f", wraps_after: {turn:.4g}")
    error = (found.channels["angle"] - values[:, 3]) / turn
    np.testing.assert_allclose(error - error[0], 0.0, atol=1.01 / turn if turn >= 500.0 else 1e-9)
    assert any("continued" in note for note in found.notes)


@given(
    turn=st.one_of(st.sampled_from([1.0, 2 * np.pi, 360.0]), st.integers(500, 65536).map(float)),
    zero=st.floats(0.0, 1.0),
    swing=st.floats(0.6, 60.0),
    scatter=st.floats(0.0, 5e-4),
    seed=st.integers(0, 99),
)
@settings(max_examples=150)
def test_any_turn_is_found_at_its_jumps(turn, zero, swing, scatter, seed):
    noise = scatter * np.random.default_rng(seed).standard_normal(len(LONG))
    stored = turning(turn, zero, swing, noise)[:, 2]
    found = starts_again(stored)
    assert abs(found.after - turn) <= 2.0 * found.uncertainty
    for bits in range(8, 17):
        if found.agrees(2.0**bits):
            assert abs(turn / 2.0**bits - 1.0) < 0.02, "no width in bits but the right one"


@given(
    seed=st.integers(0, 999),
    kind=st.sampled_from(["moves", "quick", "switches", "glitch", "noise"]),
)
@settings(max_examples=150)
def test_an_angle_that_does_not_start_again_is_left_alone(seed: int, kind: str) -> None:
    noise = np.random.default_rng(seed)
    angle = {
        "moves": np.sin(5.0 * LONG),
        "quick": np.sin((300.0 + 2.0 * seed) * LONG + seed),
        "switches": np.sign(np.sin(9.0 * LONG)) + 1e-3 * noise.standard_normal(len(LONG)),
        "glitch": 0.1 * np.sin(5.0 * LONG) + 9.0 * (np.arange(len(LONG)) == 700 + seed),
        "noise": noise.standard_normal(len(LONG)),
    }[kind]
    assert starts_again(angle) is None


def test_a_turn_that_the_column_exceeds_is_refused(tmp_path: Path) -> None:
    values = turning(4000.0, 0.0, 2.0)
    with pytest.raises(InputError, match="covers 3999 in units of its column, and `wraps_after`"):
        load_turning(tmp_path, values, ", wraps_after: 1000")
    with pytest.raises(InputError, match="wraps_after: is allowed for `angle`"):
        load(tmp_path, HEAD, "{time: {column: t, wraps_after: 9}, current: i, angle: q}")


@pytest.mark.parametrize(
    ("bits", "scale", "lost"), [(8, 1e-3, 0), (16, 1e-4, 30), (32, 1e-6, 0), (32, 1e-6, 30)]
)
def test_a_clock_through_its_end(tmp_path: Path, bits: int, scale: float, lost: int) -> None:
    ticks = np.arange(N) * round(1e-3 / scale) + 2**bits - 40 * round(1e-3 / scale)
    ticks[40:] += lost * round(1e-3 / scale)
    values = np.column_stack([ticks % 2**bits, CURRENT, 100 * ANGLE, ANGLE])
    channels = CHANNELS.replace("time: t", f"time: {{column: t, scale: {scale}}}")
    recording = load(tmp_path, HEAD + "\n".join(lines_of(",", values)), channels)
    np.testing.assert_allclose(np.diff(recording.time), 1e-3, atol=1e-9)
    assert any(f"starts again after 2^{bits}" in note for note in recording.notes)


@pytest.mark.parametrize(
    ("part", "period"),
    [(1e3, 1), (1e3, 20), (1e3, 200), (6e4, 500), (1e6, 1000), (1e9, 1_000_000)],
)
def test_a_part_of_a_second_is_no_counter_of_bits(tmp_path, part, period):
    """A column such as `msec` of 0 to 999 starts again in each second: not after 1024."""
    values = np.tile(TRUTH, (10, 1))
    values[:, 0] = (np.arange(len(values)) * period + 0.7 * part) % part
    channels = CHANNELS.replace("time: t", f"time: {{column: t, scale: {1 / part}}}")
    with pytest.raises(InputError) as refused:
        load(tmp_path, HEAD + "\n".join(lines_of(",", values)), channels)
    (problem,) = refused.value.problems
    assert "log.csv: `time` starts again" in problem
    assert "`rate`" in problem
    assert f"after {part:g} " in problem


def test_signed_numbers_stored_as_unsigned(tmp_path: Path) -> None:
    raw = np.rint(1000 * CURRENT) % 2**16
    values = np.column_stack([TIME, raw, 100 * ANGLE, ANGLE])
    channels = CHANNELS.replace("current: i", "current: {column: i, scale: 0.001}")
    recording = load(tmp_path, HEAD + "\n".join(lines_of(",", values)), channels)
    np.testing.assert_allclose(recording.channels["current"], CURRENT, atol=6e-4)
    assert any("read as signed" in note for note in recording.notes)


def test_channels_that_contradict_each_other_are_doubted(tmp_path: Path) -> None:
    values = np.column_stack([TIME, np.abs(CURRENT), ANGLE])
    text = "t,size,q\n" + "\n".join(lines_of(",", values))
    (note,) = load(tmp_path, text, "{time: t, current: size, angle: q}").notes
    assert "`current` keeps one sign" in note


def test_a_magnitude_with_noise_below_zero_is_recognised(tmp_path: Path) -> None:
    size = np.abs(CURRENT) + 0.3
    size[::60] = -0.05
    values = np.column_stack([TIME, size, ANGLE])
    text = "t,i,q\n" + "\n".join(lines_of(",", values))
    (note,) = load(tmp_path, text, "{time: t, current: i, angle: q}").notes
    assert "`current` keeps one sign (5 of 300 samples have the other)" in note
    assert "`unsigned: true`" in note
    falling = np.column_stack([TIME, size, -TIME])
    text = "t,i,q\n" + "\n".join(lines_of(",", falling))
    with pytest.raises(InputError, match=r"keeps one sign .* `unsigned: true`") as refused:
        load(tmp_path, text, "{time: t, current: i, angle: q}")
    assert "negate" not in str(refused.value)


@pytest.mark.parametrize(
    ("unit", "scale", "rate"), [("ms", 1e-3, 100.0), ("us", 1e-6, 400.0), ("ns", 1e-9, 1000.0)]
)
def test_seconds_in_another_unit_are_doubted_with_the_scale(tmp_path, unit, scale, rate):
    values = TRUTH.copy()
    values[:, 0] = np.arange(N) / rate / scale
    text = HEAD + "\n".join(lines_of(",", values))
    doubt = f"if `time` is in {unit} ({rate:.4g} Hz), set its scale to {scale:g}"
    assert any(doubt in note for note in load(tmp_path, text).notes)
    assert any(doubt in words for words in look_at_file(tmp_path / "log.csv", PLAIN).doubts)
    right = load(
        tmp_path, text, CHANNELS.replace("time: t", f"time: {{column: t, scale: {scale}}}")
    )
    assert not any("median period" in note for note in right.notes)


@pytest.mark.parametrize("pause", [6, 8, 30, 300])
@pytest.mark.parametrize("burst", [8, 20, 120])
def test_the_rhythm_of_a_log_is_no_gap(tmp_path: Path, burst: int, pause: int) -> None:
    """Bursts with pauses are uneven sampling while the pauses are not long beside the bursts."""
    count = 600
    time = (np.arange(count) + (pause - 1) * (np.arange(count) // burst)) * 1e-3
    values = np.column_stack([time, np.cos(3.0 * time), np.sin(3.0 * time), np.sin(3.0 * time)])
    text = HEAD + "\n".join(lines_of(",", values))
    channels = "{time: t, current: i, angle: q}"
    mean = (burst - 1 + pause) / burst
    (tmp_path / "log.csv").write_text(text)
    (tmp_path / "c.yaml").write_text(
        BENCH + f"recordings:\n  - file: log.csv\n    channels: {channels}\n"
    )
    if burst > 50:
        assert len(load_source(tmp_path / "c.yaml").recordings) == 5, "pieces that are long enough"
    elif pause <= 4.9 * mean:
        (recording,) = load_source(tmp_path / "c.yaml").recordings
        assert len(recording.time) == count
        assert any("count as uneven sampling" in note for note in recording.notes)
    elif pause > 5.1 * mean:
        with pytest.raises(InputError, match=r"gaps leave no span of 50 samples .* even rate"):
            load_source(tmp_path / "c.yaml")


def test_a_load_that_pulls_one_way_is_no_doubt(tmp_path: Path) -> None:
    values = np.column_stack([TIME, 8.0 + 3.0 * np.cos(12.0 * TIME), ANGLE])
    text = "t,i,q\n" + "\n".join(lines_of(",", values))
    assert load(tmp_path, text, "{time: t, current: i, angle: q}").notes == ()


def test_a_unit_beside_si_without_a_scale_is_doubted(tmp_path: Path) -> None:
    values = TRUTH * np.array([1, 1000, 1, 1])
    text = HEAD + "s,mA,rad,rad\n" + "\n".join(lines_of(",", values))
    notes = load(tmp_path, text).notes
    assert any("`current` is in mA" in note and "set the scale to 0.001" in note for note in notes)
    told = CHANNELS.replace("current: i", "current: {column: i, scale: 0.001}")
    assert not any("is in mA" in note for note in load(tmp_path, text, told).notes)


def test_objects_of_matlab_are_left_out(tmp_path: Path) -> None:
    """A `string` of MATLAB is an opaque element, which scipy reads but does not write."""

    def element(kind: int, data: bytes) -> bytes:
        return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)

    def flags(kind: int) -> bytes:
        return element(6, struct.pack("<II", kind, 0))

    held = flags(13) + element(5, struct.pack("<ii", 1, 1)) + element(1, b"")
    held += element(6, struct.pack("<I", 3))
    names = b"".join(element(1, name) for name in (b"s", b"MCOS", b"string"))
    scipy.io.savemat(tmp_path / "o.mat", {"t": TIME, "i": CURRENT, "q": ANGLE})
    with (tmp_path / "o.mat").open("ab") as file:
        file.write(element(14, flags(17) + names + element(14, held)))
    recording = load_file(tmp_path, "o.mat", "{time: t, current: i, angle: q}")
    np.testing.assert_array_equal(recording.channels["angle"], ANGLE)
    assert any("left out: objects of MATLAB" in note for note in recording.notes)


def test_structs_of_matlab_by_full_and_short_name(tmp_path: Path) -> None:
    signals = np.array(
        [([[v] for v in CURRENT], "i"), (np.column_stack([100 * ANGLE, ANGLE]), "both")],
        dtype=[("values", object), ("label", object)],
    )
    out = {"out": {"time": TIME, "signals": signals}}
    scipy.io.savemat(tmp_path / "log.mat", out, do_compression=True)
    full = (
        "{time: out.time, current: 'out.signals[0].values', "
        "motor_angle: 'out.signals[1].values[0]', angle: 'out.signals[1].values[1]'}"
    )
    recording = load_file(tmp_path, "log.mat", full)
    is_truth(recording)
    assert recording.notes == ()
    scipy.io.savemat(tmp_path / "log.mat", {"d": dict(zip(NAMES, TRUTH.T, strict=True))})
    recording = load_file(tmp_path, "log.mat", CHANNELS)
    is_truth(recording)
    assert "`time`: 't' is column 'd.t'" in recording.notes


def test_a_mat_file_without_arrays_says_what_it_holds(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "a.mat", {"s": {"text": "abc"}})
    with pytest.raises(InputError, match=r"holds no arrays of numbers, but s \(struct\)"):
        open_table(tmp_path / "a.mat", PLAIN)


FIRST_NS = 1_772_366_400_000_000_123


def test_nanoseconds_since_1970_in_parquet(tmp_path: Path) -> None:
    arrow = pytest.importorskip("pyarrow")
    parquet = importlib.import_module("pyarrow.parquet")
    stamps = FIRST_NS + np.arange(N) * 1_000_001
    for kind in (np.int64, np.uint64):
        columns = dict(zip(NAMES, TRUTH.T, strict=True)) | {"t": stamps.astype(kind)}
        parquet.write_table(arrow.table(columns), tmp_path / "log.parquet")
        channels = CHANNELS.replace("time: t", "time: {column: t, scale: 1.0e-9}")
        recording = load_file(tmp_path, "log.parquet", channels)
        np.testing.assert_array_equal(recording.time, np.arange(N) * 1_000_001 * 1e-9)
        np.testing.assert_array_equal(recording.channels["current"], CURRENT)
        assert f"read as the difference to the first, {FIRST_NS}" in recording.notes[0]
    table = arrow.table(
        {"n": arrow.array([FIRST_NS, None, FIRST_NS - 5]), "b": [True, False, None]}
    )
    parquet.write_table(table, tmp_path / "log.parquet")
    n, b = open_table(tmp_path / "log.parquet", PLAIN).read([0, 1])
    np.testing.assert_array_equal(n, [0, np.nan, -5])
    np.testing.assert_array_equal(b, [1, 0, np.nan])


def write_joint_states(path: Path, chunk: int = 1 << 20, compression: object = None) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk, compression=compression or CompressionType.ZSTD)  # type: ignore[arg-type]
        writer.start()
        schema = writer.register_schema("JointState", "jsonschema", b"{}")
        channel = writer.register_channel("/js", "json", schema)
        for k in range(N):
            when = FIRST_NS + k * 1_000_001
            stamp = {"nanosec": when % 10**9, "sec": when // 10**9}
            state = {
                "header": {"stamp": stamp},
                "position": [100.0 * ANGLE[k], ANGLE[k]],
                "effort": [CURRENT[k]],
                "image": [0] * 1000,
            }
            writer.add_message(channel, when, json.dumps(state).encode(), when)
        writer.finish()


STATES = (
    "{time: /js.header.stamp, current: '/js.effort[0]', motor_angle: '/js.position[0]', "
    "angle: '/js.position[1]'}"
)


def test_lists_and_stamps_of_mcap(tmp_path: Path) -> None:
    write_joint_states(tmp_path / "log.mcap")
    assert not any("image" in name for name in open_table(tmp_path / "log.mcap", PLAIN).names)
    recording = load_file(tmp_path, "log.mcap", STATES)
    np.testing.assert_array_equal(recording.time, np.arange(N) * 1_000_001 / 1e9)
    np.testing.assert_array_equal(recording.channels["angle"], ANGLE)
    np.testing.assert_array_equal(recording.channels["current"], CURRENT)
    assert recording.notes == ()


@pytest.mark.parametrize(
    ("chunk", "kind"),
    [(8192, CompressionType.NONE), (8192, CompressionType.ZSTD), (1 << 24, CompressionType.LZ4)],
)
def test_a_cut_off_mcap_is_read_to_its_last_whole_message(tmp_path, chunk, kind):
    path = tmp_path / "log.mcap"
    write_joint_states(path, chunk, kind)
    raw, share = path.read_bytes(), 0.6
    path.write_bytes(raw[: int(share * len(raw))])
    recording = load_file(tmp_path, "log.mcap", STATES)
    count = len(recording.time)
    # A compressor gives back whole blocks only.
    assert 0.3 * N * share < count <= N
    np.testing.assert_array_equal(recording.channels["angle"], ANGLE[:count])
    assert f"cut off: its {count} complete messages" in recording.notes[0]


def test_json_lines(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    rows = [
        json.dumps({"t": t, "s": {"sec": 5, "nanosec": k}, "d": {"i": i, "p": [m, q]}})
        for k, (t, i, m, q) in enumerate(TRUTH.tolist())
    ]
    path.write_text("\n".join([*rows, '{"t": 0.3, "d"']))
    channels = "{time: t, current: d.i, motor_angle: 'd.p[0]', angle: 'd.p[1]'}"
    recording = load_file(tmp_path, "log.jsonl", channels)
    is_truth(recording)
    assert recording.notes == (f"line {N + 1} is incomplete: dropped",)
    path.write_text('{"t": 1}\nnot\n{"t": 2}\n')
    with pytest.raises(InputError, match=r"log\.jsonl:2: not JSON"):
        load_file(tmp_path, "log.jsonl", channels)


def test_recordings_that_follow_each_other_are_no_wrap(tmp_path: Path) -> None:
    values = np.vstack([TRUTH[:256], TRUTH[:256]])
    with pytest.raises(InputError, match="`time` starts again once"):
        load(tmp_path, HEAD + "\n".join(lines_of(",", values)))


def test_a_switched_output_is_not_read_as_signed(tmp_path: Path) -> None:
    values = np.column_stack([TIME, 255.0 * (CURRENT > 0), 100 * ANGLE, ANGLE])
    recording = load(tmp_path, HEAD + "\n".join(lines_of(",", values)))
    assert recording.channels["current"].max() == 255.0


def test_nanoseconds_in_text_are_rounded_with_a_word(tmp_path: Path) -> None:
    lines = [
        f"{FIRST_NS + k * 1_000_000},{row.split(',', 1)[1]}" for k, row in enumerate(lines_of())
    ]
    channels = CHANNELS.replace("time: t", "time: {column: t, scale: 1.0e-9}")
    recording = load(tmp_path, HEAD + "\n".join(lines), channels)
    assert np.max(np.abs(recording.time - recording.time[0] - TIME)) < 5e-7
    assert "column 't' holds integers beyond 2^53: rounded to multiples of 256" in recording.notes


def delimited(
    folder: Path, text: str | bytes, options: ReadSection = PLAIN, name: str = "a.csv"
) -> Table:
    path = folder / name
    raw = text if isinstance(text, bytes) else text.encode()
    path.write_bytes(gzip.compress(raw) if name.endswith(".gz") else raw)
    return open_table(path, options)


VENDOR = (
    "Date:;2020-07-08\r\n"
    '"Trigger:;0;""Parameter values"";""Channel 1"""\r\n'
    "\r\n"
    "ms;rpm;%\r\n"
    "0.000;-10;-32.0\r\n"
    "51.200;-10;-32.6,,\r\n"
    '"102.400;-11;-33.0"\r\n'
    '"153.600";"-11";"-33.5"\r\n'
    "204.800;;-34.0;;\r\n"
    "\r\n"
    "256.000;-12;n/a\r\n"
)


def test_a_vendor_export_with_quoted_rows_commas_and_empty_cells(tmp_path: Path) -> None:
    table = delimited(tmp_path, VENDOR, ReadSection(delimiter=";", skip_rows=2))
    assert table.names == ("ms", "rpm", "%")
    time, speed, torque = table.read([0, 1, 2])
    np.testing.assert_array_equal(time, [0, 51.2, 102.4, 153.6, 204.8, 256])
    np.testing.assert_array_equal(speed, [-10, -10, -11, -11, np.nan, -12])
    np.testing.assert_array_equal(torque, [-32, -32.6, -33, -33.5, -34, np.nan])
    assert [table.place(row).rsplit(":", 1)[1] for row in (0, 4, 5)] == ["5", "9", "11"]


def test_without_header_only_indices(tmp_path: Path) -> None:
    table = delimited(tmp_path, VENDOR, ReadSection(skip_rows=4))
    assert table.names == ("", "", "")
    assert table.notes == ()
    assert table.read([0])[0][1] == 51.2
    (note,) = delimited(tmp_path, VENDOR, ReadSection(skip_rows=5)).notes
    assert "the last skipped line contains numbers" in note


@pytest.mark.parametrize(
    "raw",
    [
        b"t,\xb0C\n1,2\n3,4\n",
        b"\xef\xbb\xbft,\xc2\xb0C\n1,2\n3,4\n",
        b"# t,\xc2\xb0C\r\n1,2\r\n3,4",
    ],
)
def test_encodings_of_the_header(tmp_path: Path, raw: bytes) -> None:
    table = delimited(tmp_path, raw)
    assert table.names == ("t", "°C")
    np.testing.assert_array_equal(table.read([1])[0], [2, 4])


def test_a_units_line_below_the_header_is_told_from_a_broken_row(tmp_path: Path) -> None:
    table = delimited(tmp_path, "t,x\ns,m\n0,1\n2,3\n")
    np.testing.assert_array_equal(table.read([1])[0], [1, 3])
    assert table.units == ("s", "m")
    assert table.notes == ("line 2 below the names read as units: s, m",)
    with pytest.raises(InputError, match=r"a\.csv:2: column 't' is not a number \(got 's'\)"):
        delimited(tmp_path, "t,x\ns,1\n0,1\n").read([0])


CUT = gzip.compress(b"".join(b"%r\n" % v for v in np.random.default_rng(1).random(5000).tolist()))[
    :-5000
]


@pytest.mark.parametrize(
    ("raw", "name", "options", "words"),
    [
        (b"\n\n", "a.csv", {}, "the file is empty"),
        (b"a,b\n\n", "a.csv", {}, "no rows of numbers below line 1"),
        (
            b"\x00\x01,\x00\n1,2\n",
            "a.csv",
            {},
            "line 1 contains zero bytes, so that the file is not",
        ),
        (b"t;x\n0,5;1\n", "a.csv", {}, r"csv:2: column 't' is not a number .*read\.decimal: \",\""),
        (CUT, "a.csv.gz", {}, r"cannot be read .*; check that the file was copied"),
    ],
)
def test_a_text_without_numbers_is_refused(tmp_path, raw, name, options, words):
    (tmp_path / name).write_bytes(raw)
    with pytest.raises(InputError, match=words):
        open_table(tmp_path / name, ReadSection(**options)).read([0])


@pytest.mark.parametrize(
    ("bad", "expected"),
    [
        ("0.4,oops,1", "is not a number (got 'oops'); repair or remove the line"),
        ("0.4", "1 columns, but column 'b' is needed (got '0.4')"),
        ("0.4,2020-07-08 21:24:28,1", "is not a number (got '2020-07-08 21:24:28')"),
    ],
)
def test_one_bad_line_is_named(tmp_path: Path, bad: str, expected: str) -> None:
    rows = [f"{k / 1000},{k},{-k}" for k in range(1000)]
    rows[400] = bad
    table = delimited(tmp_path, "a,b,c\n" + "\n".join(rows))
    assert len(table.read([0])[0]) == 1000
    with pytest.raises(InputError) as caught:
        table.read([0, 1])
    assert "a.csv:402: " in str(caught.value)
    assert expected in str(caught.value)


SIX = np.arange(6) * 0.1
VALUE = np.array([1.0, -2.0, 3.5, 0.0, 7.0, 9.0])


def test_mat_in_any_orientation(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    both = np.vstack([SIX, VALUE])
    scipy.io.savemat(
        path,
        {"row": SIX[None, :], "column": VALUE[:, None], "wide": both, "tall": both.T, "one": 3.0,
        "text": "abc",
         "count": np.arange(6, dtype=np.uint8)},
    )  # fmt: skip
    table = open_table(path, PLAIN)
    columns = dict(zip(table.names, table.read(range(len(table.names))), strict=True))
    for name in ("row", "wide[0]", "tall[0]"):
        np.testing.assert_array_equal(columns[name], SIX)
    for name in ("column", "wide[1]", "tall[1]"):
        np.testing.assert_array_equal(columns[name], VALUE)
    assert columns["count"].dtype == np.float64
    compressed = tmp_path / "a.mat.gz"
    compressed.write_bytes(gzip.compress(path.read_bytes()))
    assert set(open_table(compressed, PLAIN).names) == set(table.names)


def test_npz(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez_compressed(path, t=SIX, m=np.column_stack([VALUE, -VALUE]), scalar=1.0)
    table = open_table(path, PLAIN)
    assert table.names == ("t", "m[0]", "m[1]")
    np.testing.assert_array_equal(table.read([2])[0], -VALUE)
    np.savez(path, x=np.array([object()] * 6, dtype=object))
    with pytest.raises(InputError, match="cannot be read"):
        open_table(path, PLAIN).read([0])
    np.savez(path, t=SIX)
    data = bytearray(path.read_bytes())
    data[data.index(b"PK\1\2") + 8] |= 1  # says that the member is encrypted
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"cannot be read \(File 't\.npy' is encrypted"):
        open_table(path, PLAIN)


def test_moves_from_rest_between_two_places_are_no_turns() -> None:
    rng = np.random.default_rng(0)
    places = np.repeat(np.tile([203.0, 150.0], 12), 12) + np.repeat(rng.integers(-4, 14, 24), 12)
    # One of the moves begins in slow motion against it.
    places[130:132] += [-1.0, -2.0]
    assert starts_again(places) is None
    assert starts_again(np.mod(7.0 * np.arange(300.0), 360.0)) is not None
