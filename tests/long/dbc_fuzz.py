"""A million random and mutated frames for the decoder of a drive's own CAN frames: nothing bad gets
through.

python tests/long/dbc_fuzz.py [--frames N] [--seed N]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

from drivers.can.port import EXTENDED_FLAG, REMOTE_FLAG
from drivers.clock import SimulatedClock
from drivers.dbc.codec import crc8_j1850
from drivers.dbc.link import DbcLink
from drivers.dbc.servo import DbcServo
from drivers.errors import DriveFault
from drivers.interfaces import RawFrame
from drivers.mock.wires.bus import SimulatedBus
from rig.config.bench import load_bench
from rig.config.dbc import DbcServoSection, wire

BATCH = 20
LINK_FLAGS = (EXTENDED_FLAG, REMOTE_FLAG)


class _Silence(SimulatedBus):
    """A bus on which nobody answers and only what is slipped in arrives."""

    slipped_in: list[RawFrame]

    def collect(self, timeout_s: float) -> list[RawFrame]:
        self._clock.sleep_until_ns(self._clock.now_ns() + round(timeout_s * 1e9))
        frames, self.slipped_in = getattr(self, "slipped_in", []), []
        return frames


def main(argv: list[str] | None = None) -> int:
    """Print what was fed and what was taken; any other exception than the declared one ends it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    rng = np.random.default_rng(options.seed)
    document = load_bench("practical_dbc")
    section = document.value.servo
    assert isinstance(section, DbcServoSection)
    clock = SimulatedClock()
    bus = _Silence(clock)
    link = DbcLink(clock, lambda: bus)
    channel = link.add_channel(
        wire(section, Path(document.path), True, document.problem), "the drive"
    )
    servo = DbcServo(link, channel, section.drive(100.0, 0.03))
    link.open()
    link.set_cycle(0.001, "the fuzzer")
    channel.set_cycle(0.001)
    known = sorted(channel.slots)
    counts: Counter[str] = Counter()
    began = time.perf_counter()
    while counts["fed"] < options.frames:
        frames = []
        for _ in range(BATCH):
            identifier = int(rng.choice(known)) if rng.integers(4) else int(rng.integers(0x800))
            data = bytearray(rng.bytes(int(rng.integers(9)) if rng.integers(4) == 0 else 8))
            slot = channel.slots.get(identifier)
            if slot is not None and slot.message.checksum is not None and rng.integers(2):
                data = data[: slot.message.size - 1]
                data.append(crc8_j1850(bytes(data) + b"\0"))
                counts["made good"] += 1
            flag = int(LINK_FLAGS[rng.integers(len(LINK_FLAGS))]) if rng.integers(10) == 0 else 0
            frames.append(RawFrame(clock.now_ns(), identifier | flag, bytes(data), False))
        before = {identifier: (slot.data, slot.count) for identifier, slot in channel.slots.items()}
        bus.slipped_in = frames
        channel.order(
            channel.wiring.enable[next(iter(channel.wiring.enable))], hold=bool(rng.integers(2))
        )
        try:
            link.exchange()
        except DriveFault:
            counts["faults told"] += 1
        sample = servo.sample()
        assert all(isinstance(value, bool | int | float) for value in sample)
        for identifier, slot in channel.slots.items():
            data_before, count_before = before[identifier]
            if slot.count == count_before:
                assert slot.data is data_before
                continue
            counts["taken"] += slot.count - count_before
            assert len(slot.data) == slot.message.size
            if slot.message.checksum is not None:
                assert slot.data[-1] == crc8_j1850(slot.data[:-1] + b"\0"), (
                    "a bad checksum got through"
                )
        link.take_frames()
        counts["fed"] += BATCH
    seconds = time.perf_counter() - began
    link.close()
    print(
        ", ".join(f"{name} {count}" for name, count in counts.items()),
        f"in {seconds:.0f} s; nothing bad got through",
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
