"""``rig look`` on every format: columns, clock, doubts, and a first campaign file that loads."""

import json
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from asammdf import MDF, Signal
from mcap.writer import Writer
from nptdms import ChannelObject, TdmsWriter

from rig.cli.entry import status
from rig.sources import load_source
from tests.rig.formats.campaigns import ANGLE, CURRENT, TIME, N, load_file
from tests.rig.formats.test_can_traffic import motion
from tests.rig.formats.test_can_traffic import write as write_traffic

SPEED = np.gradient(ANGLE, TIME) * 30 / np.pi
SPIKED = np.where(np.arange(N) == 40, 400.0, CURRENT)
COLUMNS = {"t": TIME, "i": SPIKED, "angle": ANGLE, "speed": SPEED}


def csv(path: Path) -> None:
    rows = "\n".join(",".join(repr(float(v)) for v in row) for row in zip(*COLUMNS.values()))  # noqa: B905
    path.write_text(",".join(COLUMNS) + "\n" + rows)


def mdf(path: Path) -> None:
    with MDF() as file:
        file.append([Signal(v, TIME, name=k) for k, v in COLUMNS.items() if k != "t"])
        file.save(path, overwrite=True)


def tdms(path: Path) -> None:
    with TdmsWriter(path) as writer:
        writer.write_segment([ChannelObject("g", k, v) for k, v in COLUMNS.items()])


def hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.update(COLUMNS)


def jsonfile(path: Path) -> None:
    path.write_text(json.dumps({k: v.tolist() for k, v in COLUMNS.items()}))


def jsonlines(path: Path) -> None:
    rows = [dict(zip(COLUMNS, row, strict=True)) for row in np.column_stack([*COLUMNS.values()])]
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))


def mcap(path: Path) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("s", "jsonschema", b"{}")
        channel = writer.register_channel("/drive", "json", schema)
        for k, row in enumerate(np.column_stack([*COLUMNS.values()])):
            data = json.dumps(dict(zip(COLUMNS, row, strict=True))).encode()
            writer.add_message(channel, k * 1_000_000, data, k * 1_000_000)
        writer.finish()


def npz(path: Path) -> None:
    np.savez(path, **COLUMNS)


def parquet(path: Path) -> None:
    import pyarrow
    import pyarrow.parquet

    pyarrow.parquet.write_table(pyarrow.table(COLUMNS), path)


WRITERS: dict[str, Callable[[Path], None]] = {
    "csv": csv,
    "mf4": mdf,
    "tdms": tdms,
    "h5": hdf5,
    "json": jsonfile,
    "jsonl": jsonlines,
    "mcap": mcap,
    "npz": npz,
    "parquet": parquet,
}


@pytest.mark.parametrize("kind", WRITERS)
def test_every_format_is_looked_at_doubted_and_loaded(tmp_path, kind, capsys):
    path = tmp_path / f"log.{kind}"
    WRITERS[kind](path)
    campaign, out = tmp_path / "c.yaml", tmp_path / "look.json"
    arguments = ["look", str(path), "--campaign", str(campaign), "--json", str(out)]
    assert status(arguments) in (None, 0)
    shown = capsys.readouterr().out
    assert "1000 Hz" in shown
    (log,) = json.loads(out.read_text())["logs"]
    for doubts in (log["doubts"], load_source(campaign).recordings[0].notes):
        assert any("`velocity` is 9" in text and "rpm" in text for text in doubts), doubts
        assert any("`current` has 1 single sample" in text for text in doubts), doubts
    channels = "{time: t, current: i, angle: angle}"
    if kind == "mf4":
        channels = channels.replace("time: t", "time: time")
    recording = load_file(tmp_path, path.name, channels)
    np.testing.assert_array_equal(recording.channels["current"], SPIKED)


def test_traffic_is_looked_at_with_a_dbc_and_its_campaign_loads(tmp_path, capsys):
    path = write_traffic(tmp_path / "log.blf", map(motion, range(N)))
    assert status(["look", str(path)]) == 2
    assert "the meaning of the frames is unknown: give a DBC file" in capsys.readouterr().err
    (tmp_path / "sub").mkdir()
    campaign = tmp_path / "sub" / "c.yaml"
    arguments = ["look", str(path), "--dbc", str(tmp_path / "bus.dbc"), "--campaign", str(campaign)]
    assert status(arguments) in (None, 0)
    assert "time is Motion.time, 1000" in capsys.readouterr().out
    assert 'dbc: "../bus.dbc"' in campaign.read_text()
    dataset = load_source(campaign)
    assert len(dataset.recordings[0].time) == N
    assert any(name.endswith("bus.dbc") for name in dataset.tables)
