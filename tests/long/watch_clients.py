"""``rig watch`` read by Foxglove's own client library while a run goes on, and its messages by
PlotJuggler's own parser: every value against the recording, to the last bit.

Needs Node with npm; for the parser, g++ and a source tree of PlotJuggler (``--plotjuggler``).
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from rig.common.sample import Sample
from rig.runs.mcap import ros
from rig.runs.mcap.layout import FRAMES_TOPIC, SAMPLE_TOPIC, decode_frames
from rig.runs.mcap.reader import Log, read_run

HERE = Path(__file__).parent
PACKAGES = ("@foxglove/ws-protocol@0.8.0", "ws@8")
RIG = [sys.executable, "-c", "from rig.cli.entry import main; main()"]
SEQUENCE = """\
sequence: 1
name: seen
stages:
  - {name: empty, stage: unloaded, tones: [{amplitude_deg: 10, frequency_Hz: 1}], duration_s: 8}
"""
Rows = dict[str, list[tuple[int, bytes]]]


def received(folder: Path) -> Rows:
    """Watch a run in real time with Foxglove's client, from its beginning to its end."""
    subprocess.run(["npm", "install", "--silent", *PACKAGES], cwd=folder, check=True)
    shutil.copy(HERE / "foxglove_client.js", folder)
    (folder / "seen.yaml").write_text(SEQUENCE)
    run = folder / "run"
    words = [*RIG, "run", "seen.yaml", "--yes", "--realtime", "--out", "run"]
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.DEVNULL) as running:
        while not (run / "run.json").exists() or not (run / "recording.mcap").exists():
            time.sleep(0.05)
            assert running.poll() is None
        watch = [*RIG, "watch", "run", "--foxglove", "--port", "0"]
        with subprocess.Popen(watch, cwd=folder, stdout=subprocess.PIPE, text=True) as watching:
            assert watching.stdout is not None
            address = None
            while address is None:
                address = re.search(r"ws://\S+", watching.stdout.readline())
            node = ["node", "foxglove_client.js", address.group(), "messages.jsonl", "15"]
            with subprocess.Popen(node, cwd=folder) as client:
                assert running.wait() == 0
                assert client.wait() == 0
            watching.terminate()
    rows: Rows = {}
    for line in (folder / "messages.jsonl").read_text().splitlines():
        topic, time_ns, data = json.loads(line)
        rows.setdefault(topic, []).append((int(time_ns), bytes.fromhex(data)))
    return rows


def compare(rows: Rows, log: Log) -> None:
    """Compare what Foxglove's client got with the recording."""
    assert [t for t, _ in rows["/sample"]] == [m.time_ns for m in log.messages[SAMPLE_TOPIC]]
    table = np.array([np.frombuffer(data[4:], "<f8") for _, data in rows["/sample"]])
    for number, name in enumerate(Sample._fields):
        assert np.ascontiguousarray(table[:, number]).tobytes() == log.samples[name].tobytes()
    assert [json.loads(data) for _, data in rows["/event"]] == list(log.events)
    frames = [frame for m in log.messages[FRAMES_TOPIC] for frame in decode_frames(m.data)]
    assert [data for _, data in rows["/can"]] == list(map(ros.can_frame, frames))
    print(f"Foxglove's client: {len(table)} samples, {len(frames)} frames, equal to the last bit")


def parse(rows: Rows, log: Log, source: Path, folder: Path) -> None:
    """Have PlotJuggler's parser read the samples and frames."""
    base = source / "plotjuggler_plugins/ParserROS/rosx_introspection"
    program = folder / "parse"
    files = [str(file) for file in sorted((base / "src").glob("*.cpp"))]
    build = ["g++", "-std=c++17", "-O0", f"-I{base / 'include'}", "-o", str(program)]
    subprocess.run([*build, str(HERE / "plotjuggler_parse.cpp"), *files], check=True)
    printed = _printed(program, folder, "/sample", ros.SAMPLE_TYPE, ros.SAMPLE_TEXT, rows)
    for number, fields in enumerate(printed):
        for name in Sample._fields:
            wanted = struct.pack(">d", log.samples[name][number]).hex().lstrip("0") or "0"
            assert fields[f"/sample/{name}"] == wanted
    count = len(printed)
    printed = _printed(program, folder, "/can", ros.FRAME_TYPE, ros.FRAME_TEXT, rows)
    frames = [frame for m in log.messages[FRAMES_TOPIC] for frame in decode_frames(m.data)]
    for fields, frame in zip(printed, frames, strict=True):
        data = [_number(fields[f"/can/data[{k}]"]) for k in range(len(frame.data))]
        assert bytes(map(int, data)) == frame.data
        assert _number(fields["/can/id"]) == frame.identifier & 0x1FFFFFFF
    print(f"PlotJuggler's parser: {count} samples, {len(frames)} frames, equal to the last bit")


def _printed(
    program: Path, folder: Path, topic: str, kind: str, text: str, rows: Rows
) -> list[dict[str, str]]:
    (folder / "text").write_text(text)
    (folder / "hex").write_text("".join(f"{data.hex()}\n" for _, data in rows[topic]))
    words = [str(program), topic, kind, str(folder / "text"), str(folder / "hex")]
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    return [dict(item.split("=", 1) for item in line.split()) for line in done.stdout.splitlines()]


def _number(bits: str) -> float:
    return float(struct.unpack(">d", bytes.fromhex(bits.zfill(16)))[0])


def main() -> None:
    """Run both comparisons."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--plotjuggler", type=Path, help="source tree of PlotJuggler")
    source = options.parse_args().plotjuggler
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        rows = received(folder)
        log = read_run(folder / "run" / "recording.mcap")
        compare(rows, log)
        if source is not None:
            parse(rows, log, source, folder)


if __name__ == "__main__":
    main()
