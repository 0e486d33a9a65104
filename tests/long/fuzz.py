"""A million random and mutated frames or bytes for every decoder: no exception but the declared
ones.

Each function takes how much to do and a generator, and returns counts. Frames are half random, half
mutations of good ones (identifier, length, bits), since random ones alone seldom get past the first
check.
"""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from drivers.amt21 import encoder as amt21
from drivers.can import slcan
from drivers.can.port import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FramePort
from drivers.canopen.cia402_servo import Cia402Servo
from drivers.canopen.link import CanopenLink
from drivers.canopen.sensors import Cia406Encoder
from drivers.clock import NS, SimulatedClock
from drivers.epos import frames as epos_serial
from drivers.errors import DeviceError
from drivers.interfaces import RawFrame
from drivers.mock.bench import DRIVE_NODE, ENCODER_NODE, simulated_bench
from drivers.mock.drive import DRIVE_EDS
from drivers.mock.encoder import ENCODER_EDS
from drivers.mock.plant.parts.constants import Machine
from drivers.units import EncoderScales, ServoScales
from rig.common.sample import Sample
from rig.runs.mcap.reader import NotARecordingError, read_run
from rig.runs.recorder import open_recorder

BATCH = 50
CYCLE_S = 0.001
SCALES = ServoScales(
    counts_per_turn=4096, gear_ratio=100.0, rated_current_A=15.0, rated_torque_N_m=0.45
)
_FLAGS = (0, 0, 0, 0, 0, EXTENDED_FLAG, REMOTE_FLAG, ERROR_FLAG)


class _Tap:
    """A port into which frames can be slipped, and whose own traffic can be cut off."""

    def __init__(self, inner: FramePort, clock: SimulatedClock) -> None:
        self._inner = inner
        self._clock = clock
        self.slipped_in: list[RawFrame] = []
        self.seen: list[RawFrame] = []
        self.cut = False

    def transmit(self, identifier: int, data: bytes) -> None:
        if not self.cut:
            self._inner.transmit(identifier, data)

    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        if self.slipped_in:
            frames, self.slipped_in = self.slipped_in, []
            return frames
        if self.cut:
            self._clock.sleep_until_ns(self._clock.now_ns() + round(timeout_s * NS))
            return ()
        frames = list(self._inner.collect(timeout_s))
        self.seen += frames
        return frames

    def shutdown(self) -> None:
        self._inner.shutdown()


def mutated(frame: RawFrame, rng: np.random.Generator) -> RawFrame:
    """Return a frame with one thing wrong."""
    identifier, data = frame.identifier, bytearray(frame.data)
    match int(rng.integers(5)):
        case 0:
            identifier ^= 1 << int(rng.integers(11))
        case 1:
            data = data[: int(rng.integers(len(data) + 1))]
        case 2:
            data += rng.bytes(int(rng.integers(1, 5)))
        case 3 if data:
            data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        case _:
            identifier |= int(_FLAGS[rng.integers(5, 8)])
    return frame._replace(identifier=identifier, data=bytes(data[:64]))


def random_frame(rng: np.random.Generator) -> RawFrame:
    """Return a frame of anything."""
    identifier = int(rng.integers(0x800)) | int(_FLAGS[rng.integers(len(_FLAGS))])
    return RawFrame(0, identifier, rng.bytes(int(rng.integers(9))), False)


def fuzz_link(count: int, rng: np.random.Generator) -> Counter[str]:
    """Feed frames to the host's link while its devices are silent.

    A frame that is not whole process data of the right identifier must leave every sample as it
    was; one that is may change the sample, which must then still be computed.
    """
    bench = simulated_bench(Machine(), 0)
    tap = _Tap(bench.bus, bench.clock)
    link = CanopenLink(bench.clock, lambda: tap)
    drive = link.add_node(DRIVE_NODE, DRIVE_EDS)
    nodes = (drive, link.add_node(ENCODER_NODE, ENCODER_EDS))
    servo = Cia402Servo(drive, link, SCALES)
    encoder = Cia406Encoder(
        nodes[1], EncoderScales(bench.machine.constants.sensing.joint_counts_per_turn)
    )
    link.open()
    servo.prepare(CYCLE_S)
    encoder.prepare(CYCLE_S)
    for _ in range(20):
        link.exchange()
    good, tap.cut = tap.seen, True
    lengths = {identifier: slot.size for node in nodes for identifier, slot in node.inputs.items()}
    counts: Counter[str] = Counter()
    for _ in range(-(-count // BATCH)):
        frames = [
            random_frame(rng) if rng.integers(2) else mutated(good[rng.integers(len(good))], rng)
            for _ in range(BATCH)
        ]
        bad = [f for f in frames if lengths.get(f.identifier) != len(f.data)]
        before = [slot.values for node in nodes for slot in node.inputs.values()]
        counts += _exchange(link, tap, bad)
        after = [slot.values for node in nodes for slot in node.inputs.values()]
        assert before == after, f"a bad frame changed a sample: {bad}"
        counts += _exchange(link, tap, [f for f in frames if f not in bad])
        servo.sample()
        encoder.sample()
        counts["frames"] += BATCH
        counts["bad"] += len(bad)
        link.take_frames()
    link.close()
    return counts


def _exchange(link: CanopenLink, tap: _Tap, frames: list[RawFrame]) -> Counter[str]:
    tap.slipped_in = frames
    try:
        link.exchange()
    except DeviceError as error:
        return Counter([type(error).__name__])
    return Counter()


class _Liar:
    """A port behind which every SDO request is answered with nonsense."""

    def __init__(self, clock: SimulatedClock, rng: np.random.Generator) -> None:
        self._clock = clock
        self._rng = rng
        self._answers: list[RawFrame] = []
        self.sent = 0

    def transmit(self, identifier: int, data: bytes) -> None:
        rng = self._rng
        self.sent += 1
        command = int(_SDO_COMMANDS[rng.integers(len(_SDO_COMMANDS))])
        answer = RawFrame(0, 0x581, bytes([command]) + data[1:4] + rng.bytes(4), False)
        match int(rng.integers(4)):
            case 0:
                answer = mutated(answer, rng)
            case 1:
                answer = answer._replace(data=rng.bytes(8))
        self._answers = [answer] * int(rng.integers(0, 3))

    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        answers, self._answers = self._answers, []
        if not answers:
            self._clock.sleep_until_ns(self._clock.now_ns() + round(timeout_s * NS))
        return answers

    def shutdown(self) -> None:
        """Nothing to close."""


_SDO_COMMANDS = (0x43, 0x4B, 0x4F, 0x41, 0x40, 0x60, 0x80, 0x00, 0x10, 0x01, 0x11, 0x20, 0x30)


def fuzz_sdo_client(count: int, rng: np.random.Generator) -> Counter[str]:
    """Read and write objects of a device that answers nonsense, for ``count`` requests."""
    clock = SimulatedClock()
    liar = _Liar(clock, rng)
    link = CanopenLink(clock, lambda: liar)
    drive = link.add_node(DRIVE_NODE, DRIVE_EDS)
    link.open()
    counts: Counter[str] = Counter()
    actions = (
        lambda: drive.read(0x6041),
        lambda: drive.read_text(0x1008),
        lambda: drive.write(0x607A, 0, 1),
    )
    while liar.sent < count:
        try:
            actions[rng.integers(3)]()
            counts["taken for good"] += 1
        except DeviceError as error:
            counts[type(error).__name__] += 1
        link.take_frames()
    link.close()
    return counts + Counter(frames=liar.sent)


def fuzz_twins(count: int, rng: np.random.Generator) -> Counter[str]:
    """Feed frames to the simulated devices as a mad host would; they answer what they like, and go
    on.
    """
    bench = simulated_bench(Machine(), 0)
    good = [
        RawFrame(0, 0x000, bytes([1, 1]), True),
        RawFrame(0, 0x080, b"", True),
        RawFrame(0, 0x201, bytes(6), True),
        RawFrame(0, 0x77F, b"\x05", True),
        RawFrame(0, 0x601, bytes.fromhex("2b4060000f000000"), True),
        RawFrame(0, 0x601, bytes.fromhex("4041600000000000"), True),
        RawFrame(0, 0x602, bytes.fromhex("4004600000000000"), True),
        RawFrame(0, 0x601, bytes.fromhex("2116100000000000"), True),
        RawFrame(0, 0x602, bytes.fromhex("6000000000000000"), True),
    ]
    counts: Counter[str] = Counter()
    for _ in range(-(-count // BATCH)):
        for _ in range(BATCH):
            frame = (
                random_frame(rng)
                if rng.integers(2)
                else mutated(good[rng.integers(len(good))], rng)
            )
            bench.bus.transmit(frame.identifier & 0x7FF, frame.data[:8])
        counts["frames"] += BATCH
        counts["answers"] += len(bench.bus.collect(0.01))
        bench.clock.sleep_until_ns(bench.clock.now_ns() + NS // 100)
    bench.bus.shutdown()
    return counts


def fuzz_epos_serial(count: int, rng: np.random.Generator) -> Counter[str]:
    """Feed ``count`` bytes of noise and of damaged frames to the EPOS decoder, in pieces of any
    length.

    What it takes for a frame must have been on the line byte by byte, check sum and stuffing
    included, and a good frame after a pause on the line must still be found.
    """
    decoder = epos_serial.FrameDecoder()
    counts: Counter[str] = Counter()
    while counts["bytes"] < count:
        line = bytearray()
        for _ in range(20):
            good = bytearray(
                epos_serial.encode(int(rng.integers(256)), rng.bytes(2 * int(rng.integers(8))))
            )
            match int(rng.integers(4)):
                case 0:
                    good = bytearray(rng.bytes(len(good)))
                case 1:
                    good[rng.integers(len(good))] ^= 1 << int(rng.integers(8))
                case 2:
                    del good[rng.integers(len(good))]
            line += good
        at = 0
        while at < len(line):
            step = int(rng.integers(1, 40))
            for found in decoder.feed(bytes(line[at : at + step])):
                counts["frames"] += 1
                assert epos_serial.encode(*found) in line, f"{found} was never on the line"
            at += step
        counts["bytes"] += len(line)
        decoder.clear()
        whole = epos_serial.Frame(0x60, rng.bytes(4))
        assert decoder.feed(epos_serial.encode(*whole)) == [whole]
        decoder.clear()
    counts["dropped"] = decoder.bad
    return counts


def fuzz_slcan(count: int, rng: np.random.Generator) -> Counter[str]:
    """Feed ``count`` bytes of noise and of damaged lines to the decoder of CAN adapters on a serial
    line.

    What it takes for a frame must have been a whole line, and every good line after the next end of
    one must be found.
    """
    decoder = slcan.LineDecoder()
    counts: Counter[str] = Counter()
    while counts["bytes"] < count:
        line = bytearray()
        for _ in range(20):
            good = bytearray(
                slcan.encode(int(rng.integers(0x800)), rng.bytes(int(rng.integers(9))))
            )
            match int(rng.integers(4)):
                case 0:
                    good = bytearray(rng.bytes(len(good)))
                case 1:
                    good[rng.integers(len(good))] ^= 1 << int(rng.integers(8))
                case 2:
                    del good[rng.integers(len(good))]
            line += good
        whole = int(rng.integers(0x800)), rng.bytes(8)
        line += b"\r" + slcan.encode(*whole)
        found = []
        at = 0
        while at < len(line):
            step = int(rng.integers(1, 40))
            found += decoder.feed(bytes(line[at : at + step]))
            at += step
        said = b"\r" + bytes(line).replace(b"\a", b"\r").upper()
        for identifier, data in found:
            if identifier <= 0x7FF:
                text = b"\r" + slcan.encode(identifier, data)[:-1].upper()
                assert text in said, f"{identifier:03X} {data.hex()} was never on the line"
        assert found[-1] == whole
        counts["frames"] += len(found)
        counts["bytes"] += len(line)
    counts["dropped"] = decoder.bad
    return counts


def fuzz_amt21(count: int, rng: np.random.Generator) -> Counter[str]:
    """Feed ``count`` answers of 0 to 4 bytes to the AMT21 decoder; those it takes are whole words
    that check.
    """
    counts: Counter[str] = Counter()
    for _ in range(count):
        answer = rng.bytes(2 if rng.integers(4) else int(rng.integers(5)))
        value = amt21.decode(answer)
        counts["frames"] += 1
        if value is not None:
            assert amt21.encode(value) == answer
            counts["taken for good"] += 1
    return counts


def fuzz_recording(count: int, rng: np.random.Generator, folder: Path) -> Counter[str]:
    """Damage a recording of some 20 kB in ``count`` / 50 ways; what is still read is a part of what
    was written.
    """
    whole = folder / "whole.mcap"
    write_recording(whole, 200)
    content = whole.read_bytes()
    times = read_run(whole).samples["time"]
    path = folder / "damaged.mcap"
    counts: Counter[str] = Counter()
    for _ in range(-(-count // 50)):
        path.write_bytes(damaged(content, rng))
        counts["files"] += 1
        try:
            log = read_run(path)
        except NotARecordingError:
            counts["NotARecordingError"] += 1
            continue
        found = log.samples["time"]
        counts["damage reported"] += log.damage is not None
        assert np.isin(found, times).all(), (
            "a damaged recording gave a sample that was never written"
        )
    return counts


def write_recording(path: Path, samples: int) -> None:
    """Write a small recording with samples, frames, events and an attachment."""
    recorder = open_recorder(path)
    recorder.metadata("run", {"name": "fuzz"})
    recorder.attach("run.json", "application/json", b"{}")
    for number in range(samples):
        values = np.random.default_rng(number).standard_normal(len(Sample._fields) - 1)
        sample = Sample(number * 0.001, *values.tolist())
        recorder.sample(number * 1_000_000, sample, [RawFrame(number, 0x181, bytes(8), False)])
        if number % 50 == 0:
            recorder.event(number * 1_000_000, "note", number=number)
    recorder.close()


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content with bits flipped, bytes zeroed, a piece missing or the end cut off, up to
    three times.
    """
    spoiled = bytearray(content)
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(len(spoiled)))
        match int(rng.integers(5)):
            case 0:
                spoiled[at] ^= 1 << int(rng.integers(8))
            case 1:
                spoiled[at : at + 8] = rng.bytes(8)
            case 2:
                spoiled[at : at + int(rng.integers(1, 4096))] = bytes(int(rng.integers(1, 4096)))
            case 3:
                del spoiled[at : at + int(rng.integers(1, 512))]
            case _:
                del spoiled[max(at, 1) :]
    return bytes(spoiled)


DECODERS: Mapping[str, Callable[[int, np.random.Generator], Counter[str]]] = {
    "host's CAN link": fuzz_link,
    "host's SDO client": fuzz_sdo_client,
    "simulated devices": fuzz_twins,
    "EPOS serial": fuzz_epos_serial,
    "slcan": fuzz_slcan,
    "AMT21": fuzz_amt21,
}


def main() -> int:
    """Fuzz every decoder and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1_000_000, help="frames per decoder")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    logging.disable()
    for name, decode in DECODERS.items():
        _report(name, decode, options.count, options.seed)
    with tempfile.TemporaryDirectory() as folder:
        _report(
            "recordings",
            lambda n, rng: fuzz_recording(n, rng, Path(folder)),
            options.count,
            options.seed,
        )
    return 0


def _report(
    name: str, decode: Callable[[int, np.random.Generator], Counter[str]], count: int, seed: int
) -> None:
    began = time.monotonic()
    counts = decode(count, np.random.default_rng(seed))
    print(f"{name}: {dict(counts)}, {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    sys.exit(main())
