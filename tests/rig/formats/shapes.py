"""Random logs of every format, and what must hold of each: it is read to the last bit, or something
is said.

Each property takes a drawn log and a folder; ``tests/long/fuzz.py`` runs them many times.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from random import Random
from typing import Any

import can
import h5py
import numpy as np
from asammdf import MDF, Signal
from cantools.database.can import Database, Message
from cantools.database.can.signal import Signal as BusSignal
from cantools.database.conversion import BaseConversion
from nptdms import ChannelObject, TdmsWriter

from rig.common.errors import InputError
from rig.config.campaign_sections import ReadSection
from rig.sources.can_traffic import CanTable
from rig.sources.formats import open_table
from rig.sources.table import Table

NAMES = ("t", "i", "q", "x y", "pos[deg]", "a.b", "Zeit", "I_ist")
ODD = (0.0, -0.0, 1e-300, 1e300, 0.1, 1 / 3, 1e22, 5e-324)
KINDS = ("i1", "u1", "<i2", ">i2", "<u4", ">i4", "<i8", "<u8", "<f4", ">f4", "<f8", ">f8")


def frames_of_numbers(rng: Random) -> dict[str, list[float]]:
    """Columns of one length, by name."""
    names = rng.sample(NAMES, rng.randint(2, 4))
    rows = rng.randint(2, 8)

    def number() -> float:
        kind = rng.randrange(3)
        if kind == 0:
            return rng.choice(ODD)
        return rng.uniform(-1e6, 1e6) if kind == 1 else float(rng.randint(-(2**31), 2**31))

    return {n: [number() for _ in range(rows)] for n in names}


def arrays(rng: Random) -> dict[str, np.ndarray]:
    """Columns of one length and of many types, by name."""
    names = rng.sample(NAMES[:3] + NAMES[6:], rng.randint(1, 3))
    rows = rng.randint(2, 12)
    noise = np.random.default_rng(rng.getrandbits(32))
    found = {}
    for name in names:
        kind = np.dtype(rng.choice(KINDS))
        raw = noise.integers(0, 256, rows * kind.itemsize, dtype=np.uint8).tobytes()
        values = np.frombuffer(raw, kind).copy()
        if kind.kind == "f":
            values[~np.isfinite(values)] = 0.5
        found[name] = values
    return found


def columns(table: Table) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Return every column by name, and the notes."""
    return {n: table.read([k])[0] for k, n in enumerate(table.names)}, table.notes


def require(found: np.ndarray, truth: np.ndarray, notes: Sequence[str], what: str) -> None:
    """Hold values against the truth: equal to the last bit, or something was said."""
    same = found.shape == truth.shape and np.array_equal(found, truth, equal_nan=True)
    assert same or notes, f"{what}: {found} is not {truth}, and nothing was said"


def as_float(values: np.ndarray) -> np.ndarray:
    """Return the truth as doubles; integers beyond 2^53 as differences to the first."""
    if values.dtype.kind in "iu" and any(abs(int(v)) > 2**53 for v in values):
        return np.array([float(int(v) - int(values[0])) for v in values])
    return values.astype(np.float64)


def csv_logs(rng: Random) -> tuple[bytes, dict[str, list[float]], dict[str, Any], bool]:
    """A text file in some tool's shape, its truth, read options, and whether it was spoiled."""
    truth = frames_of_numbers(rng)
    delimiter = rng.choice([",", ";", "\t", "|", " "])
    decimal = rng.choice([".", ".", ","]) if delimiter != "," else "."
    style = rng.choice(["{!r}", "{:.17g}", "{:.17e}"])
    names = [n.replace(" ", "_") for n in truth] if delimiter == " " else list(truth)
    rows = [
        [style.format(v).replace(".", decimal) for v in row]
        for row in zip(*truth.values(), strict=True)
    ]
    spoiled = rng.choice(["no", "no", "no", "more", "fewer", "word", "late"])
    place = rng.randint(0, len(rows) - 1)
    if spoiled == "more":
        rows[place].insert(rng.randint(0, len(names)), "7")
    elif spoiled == "fewer":
        rows[place].pop(rng.randint(0, len(names) - 1))
    elif spoiled == "word":
        rows[place][rng.randint(0, len(names) - 1)] = rng.choice(["ERR", "1.2.3", "12 34", "?"])
    quoted = rng.random() < 0.5
    if quoted:
        rows = [[f'"{cell}"' for cell in row] for row in rows]
        names = [f'"{name}"' for name in names]
    gap = delimiter * rng.randint(1, 3) if delimiter == " " else delimiter
    lines = [gap.join(names)]
    if rng.random() < 0.5 and delimiter != " ":
        lines.append(gap.join(["s", "A", "rad", "-"][: len(names)]))
    lines += [gap.join(row) for row in rows]
    if spoiled == "late":
        lines += ["EOF", gap.join(["9"] * len(names))]
    else:
        lines += rng.choice([[], [""], ["EOF"], ["# end"]])
    skip = rng.randint(0, 2)
    lines = ["; made by a tool"] * skip + lines
    ending = rng.choice(["\n", "\r\n"])
    text = ending.join(lines) + rng.choice(["", ending])
    encoding = rng.choice(["utf-8", "utf-8-sig", "utf-16", "latin-1"])
    clean = {name.strip('"'): values for name, values in zip(names, truth.values(), strict=True)}
    return text.encode(encoding), clean, {"skip_rows": skip, "decimal": decimal}, spoiled != "no"


def csv_property(
    case: tuple[bytes, dict[str, list[float]], dict[str, Any], bool], folder: Path
) -> None:
    raw, truth, options, spoiled = case
    path = folder / "a.csv"
    path.write_bytes(raw)
    try:
        table = open_table(path, ReadSection(**options))
        read = table.read(range(len(table.names)))
    except InputError:
        assert spoiled, raw
        return False
    if table.names != tuple(truth) and not table.notes and not spoiled:
        raise AssertionError(f"names {table.names} of {tuple(truth)}, and nothing was said")
    for found, (name, values) in zip(read, truth.items(), strict=False):
        require(found, np.array(values), table.notes, name)
    return True


def json_logs(rng: Random) -> tuple[str, str, dict[str, list[float]]]:
    """Text, extension and truth of a JSON log."""
    truth = frames_of_numbers(rng)
    if rng.random() < 0.5:
        name = rng.choice(sorted(truth))
        base = rng.randint(0, 2**62)
        truth[name] = [base + k for k in range(len(truth[name]))]
    names, rows = list(truth), list(map(list, zip(*truth.values(), strict=True)))
    records = [dict(zip(names, row, strict=True)) for row in rows]
    if rng.random() < 0.5:
        return "\n".join(map(json.dumps, records)), "jsonl", truth
    labels = [str(k) for k in range(len(rows))]
    value: Any = rng.choice(
        [
            records,
            dict(truth),
            [names, *rows],
            {"columns": names, "index": labels, "data": rows},
            {n: dict(zip(labels, v, strict=True)) for n, v in truth.items()},
            dict(zip(labels, records, strict=True)),
        ]
    )
    beside = rng.choice([None, {"by": "me"}, [1], "text", {"limits": [1, 2, 3]}])
    if rng.random() < 0.5:
        value = {"meta": beside, "run": {"log": value}}
    return json.dumps(value, indent=rng.choice([None, 1])), "json", truth


def json_property(case: tuple[str, str, dict[str, list[float]]], folder: Path) -> bool:
    text, extension, truth = case
    path = folder / f"a.{extension}"
    path.write_text(text)
    found, notes = columns(open_table(path, ReadSection()))
    for name, values in truth.items():
        matches = [n for n in found if n == name or n.endswith(f".{name}")]
        assert len(matches) == 1, f"{name} is {matches} in {text[:200]}"
        whole = all(isinstance(v, int) for v in values)
        truly = as_float(np.array(values, np.int64)) if whole else np.array(values, np.float64)
        require(found[matches[0]], truly, () if whole else notes, name)
    return True


def bus_logs(rng: Random) -> tuple[Database, list[can.Message]]:
    """A DBC made by cantools, and frames of random bytes for it."""
    messages = []
    for number in range(rng.randint(1, 2)):
        size = rng.choice([1, 2, 4, 8, 8, 8, 64])
        extended = rng.random() < 0.5
        selectors: list[str] = []
        signals = []
        count = rng.randint(1, min(4, size))
        # Each signal has bytes of its own.
        for k in range(count):
            area = (size * k // count, size * (k + 1) // count)
            signals.append(bus_signals(rng, f"S{k}", area, selectors))
            if signals[-1].is_multiplexer:
                selectors.append(signals[-1].name)
        messages.append(
            Message(
                frame_id=0x100 + number + (0x18FF0000 if extended else 0),
                name=f"M{number}",
                length=size,
                signals=signals,
                is_extended_frame=extended,
                is_fd=size > 8,
                strict=False,
            )
        )
    frames = []
    noise = np.random.default_rng(rng.getrandbits(32))
    cut = rng.random() < 0.5
    for k in range(rng.randint(1, 60)):
        message = messages[int(noise.integers(len(messages)))]
        length = message.length if not cut else int(noise.integers(0, message.length + 1))
        if length > 8:
            length = max(n for n in (8, 12, 16, 20, 24, 32, 48, 64) if n <= length)
        data = noise.integers(0, 256, length, dtype=np.uint8)
        if length:
            data[0] &= int(noise.choice([0xFF, 0x01, 0x03]))
        frames.append(
            can.Message(
                timestamp=k * 1e-3,
                arbitration_id=message.frame_id,
                is_extended_id=message.is_extended_frame,
                is_fd=message.length > 8,
                data=data.tobytes(),
                channel=0,
            )
        )
    return Database(messages, strict=False), frames


def bus_signals(rng: Random, name: str, area: tuple[int, int], selectors: list[str]) -> BusSignal:
    size = area[1] - area[0]
    order = rng.choice(["little_endian", "big_endian"])
    real = rng.choice([False, False, True]) and size >= 4
    length = (
        rng.choice([32, 64] if size >= 8 else [32]) if real else rng.randint(1, min(64, 8 * size))
    )
    first = 8 * area[0] + rng.randint(0, 8 * size - length)
    # Counted from the left of the frame where the most significant bit comes first.
    start = first if order == "little_endian" else first // 8 * 8 + 7 - first % 8
    under = rng.choice([None, *selectors])
    selects = (
        not real and length <= 8 and rng.random() < 0.5 and (under is not None or not selectors)
    )
    scale = rng.choice([1, 0.5, 0.001, -2.0, 1e-6])
    offset = rng.choice([0, 0, -40, 0.25])
    return BusSignal(
        name,
        start,
        length,
        order,
        is_signed=rng.random() < 0.5 and not real,
        conversion=BaseConversion.factory(scale, offset, None, real),
        is_multiplexer=selects,
        multiplexer_ids=[rng.randint(0, 3)] if under else None,
        multiplexer_signal=under,
    )


def bus_property(case: tuple[Database, list[can.Message]], folder: Path) -> bool:
    database, frames = case
    (folder / "a.dbc").write_text(database.as_dbc_string())
    path = folder / "a.blf"
    with can.BLFWriter(str(path)) as writer:
        for frame in frames:
            writer.on_message_received(frame)
    try:
        found, _ = columns(CanTable(path, ReadSection(dbc=(str(folder / "a.dbc"),))))
    except InputError:
        return False
    for message in database.messages:
        truth: dict[str, list[float]] = {}
        for frame in frames:
            if frame.arbitration_id == message.frame_id:
                for name, value in _decoded(message, bytes(frame.data)).items():
                    truth.setdefault(name, []).append(value)
        for name, values in truth.items():
            column = f"{message.name}.{name}"
            signal = message.get_signal_by_name(name)
            exact = np.array(values, np.float64)
            if not signal.is_float and signal.scale == 1 and signal.offset == 0:
                exact = as_float(np.array(values, np.uint64 if min(values) >= 0 else np.int64))
            assert column in found, f"{column} is missing in {list(found)}"
            read = found[column]
            if signal.length > 53 and signal.offset:
                # cantools adds the offset to a whole number, which no double may hold.
                np.testing.assert_allclose(read, exact, rtol=1e-15)
                continue
            assert np.array_equal(read, exact, equal_nan=True), (signal, read - exact, exact)
    return True


def _decoded(message: Message, data: bytes) -> dict[str, Any]:
    """Return what cantools finds in a frame, signal by signal, of the pages that are there."""

    def alone(signal: BusSignal, scaling: bool = True) -> Any:
        place = (signal.name, signal.start, signal.length, signal.byte_order, signal.is_signed)
        plain = BusSignal(*place, conversion=signal.conversion)
        single = Message(1, "A", message.length, [plain], strict=False)
        found = single.decode(data, decode_choices=False, scaling=scaling, allow_truncated=True)
        return found.get(signal.name)

    def there(signal: BusSignal) -> bool:
        if not signal.multiplexer_ids or signal.multiplexer_signal is None:
            return True
        above = message.get_signal_by_name(signal.multiplexer_signal)
        page = alone(above, scaling=False)
        mask = (1 << above.length) - 1
        return page is not None and there(above) and page & mask in signal.multiplexer_ids

    found = {signal.name: alone(signal) for signal in message.signals if there(signal)}
    return {name: value for name, value in found.items() if value is not None}


def write_mdf(path: Path, case: dict[str, np.ndarray]) -> None:
    time = np.arange(len(next(iter(case.values())))) * 1e-3
    with MDF() as mdf:
        mdf.append([Signal(v, time, name=n) for n, v in case.items()])
        mdf.save(path, overwrite=True)


def write_tdms(path: Path, case: dict[str, np.ndarray]) -> None:
    native = {n: v.astype(v.dtype.newbyteorder("=")) for n, v in case.items()}
    with TdmsWriter(path) as writer:
        writer.write_segment([ChannelObject("g", n, v) for n, v in native.items()])


def write_hdf5(path: Path, case: dict[str, np.ndarray]) -> None:
    with h5py.File(path, "w") as file:
        file.update(case)


ARRAY_WRITERS: Mapping[str, Callable[[Path, dict[str, np.ndarray]], None]] = {
    "mf4": write_mdf,
    "tdms": write_tdms,
    "h5": write_hdf5,
    "npz": lambda path, case: np.savez(path, **case),
}


def array_logs(extension: str) -> Callable[[Random], tuple[str, dict[str, np.ndarray]]]:
    return lambda rng: (extension, {f"c_{n}": v for n, v in arrays(rng).items()})


def array_property(case: tuple[str, dict[str, np.ndarray]], folder: Path) -> bool:
    extension, truth = case
    path = folder / f"a.{extension}"
    ARRAY_WRITERS[extension](path, truth)
    found, _ = columns(open_table(path, ReadSection()))
    for name, values in truth.items():
        require(found[name], as_float(values), (), name)
    return True


PROPERTIES: Mapping[str, tuple[Callable[[Random], Any], Callable[[Any, Path], bool]]] = {
    "csv": (csv_logs, csv_property),
    "json": (json_logs, json_property),
    "dbc": (bus_logs, bus_property),
    **{extension: (array_logs(extension), array_property) for extension in ARRAY_WRITERS},
}
"""Format to its random logs, and what must hold of them; whether one was read, and not refused."""
