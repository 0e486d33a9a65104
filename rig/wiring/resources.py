"""Returns the lock keys of the ports, adapters and channels of a bench; only one program may use
each of these.
"""

from __future__ import annotations

import os
from typing import Final

from rig.common.locks import Resource
from rig.config.bench import Bench
from rig.config.canopen import Bus
from rig.config.serial_bus import Amt21Section, SerialBus

_IN_PROCESS: Final = "virtual"
"""Interface of python-can with a bus inside this process, which no other process can reach."""
_ON_SERIAL_PORTS: Final = frozenset({"slcan", "robotell", "seeedstudio", "serial"})
"""Interfaces of python-can whose channel is a serial port, as a path or as a URL of pyserial."""
_WITH_RATE: Final = frozenset({"slcan", "robotell"})
"""Interfaces of python-can whose channel may end in ``@`` and the bit rate of the port."""


def resources(bench: Bench) -> tuple[Resource, ...]:
    """Return the resources that a program must lock to use this bench; none for a simulated bench.

    All names of a device have one key in common. The key of an interface with a channel does not
    depend on the bench file.
    """
    found = [*bus_resources(bench)]
    if not bench.simulated and bench.bus and isinstance(bench.encoder, Amt21Section):
        found += _port(bench.encoder.port)
    return tuple(sorted({part.key: part for part in reversed(found)}.values()))


def bus_resources(bench: Bench) -> tuple[Resource, ...]:
    """Return those resources of a bench through which its drive is reached."""
    bus = bench.bus
    if bus is None or bench.simulated:
        return ()
    return tuple(_port(bus.port) if isinstance(bus, SerialBus) else _channel(bus))


def _channel(bus: Bus) -> list[Resource]:
    """Return the channel of a CAN interface, or its serial port."""
    channel = bus.channel or ""
    if bus.interface == _IN_PROCESS:
        return []
    if bus.interface in _WITH_RATE:
        channel = channel.partition("@")[0]
    if "://" not in channel and (bus.interface in _ON_SERIAL_PORTS or os.sep in channel):
        return _port(channel)
    return [
        Resource(f"{bus.interface}:{channel}", f"{bus.interface} channel {channel or 'by default'}")
    ]


def _port(path: str) -> list[Resource]:
    """Return the device file behind a name, and the name itself if it is a symbolic link: the link
    of an adapter that is unplugged is gone, and may later lead to another device file.
    """
    label = f"port {path}"
    try:
        real = os.path.realpath(path)
        name = os.path.join(os.path.realpath(os.path.dirname(path)), os.path.basename(path))
    except ValueError:
        # A text with a null character is not a path.
        return [Resource(path, label)]
    return [Resource(key, label) for key in dict.fromkeys((real, name))]
