"""DBC files and maps of drives of other kinds than the simulated one, for tests."""

from dataclasses import replace
from pathlib import Path

from drivers.dbc.bind import bind
from drivers.dbc.codec import Wiring
from drivers.dbc.file import Layout, read_dbc
from drivers.dbc.map import DbcMap, Inputs, Orders, Quantity, Status, StopFrame

HEAD = 'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: A B\n\n'
MOTOR = """\
BO_ 1 Command: 8 A
 SG_ Pos : 7|16@0+ (0.0004,-12.5) [0|0] "rad" B
 SG_ Vel : 23|12@0+ (0.02,-45) [0|0] "rad/s" B
 SG_ Kp : 27|12@0+ (0.1,0) [0|0] "" B
 SG_ Kd : 47|12@0+ (0.001,0) [0|0] "" B
 SG_ Torque : 51|12@0+ (0.01,-20.48) [0|0] "N m" B

BO_ 2 Reply: 6 B
 SG_ State : 7|8@0+ (1,0) [0|0] "" A
 SG_ Pos : 15|16@0+ (0.0004,-12.5) [0|0] "rad" A
 SG_ Vel : 31|12@0+ (0.02,-45) [0|0] "rad/s" A
 SG_ Torque : 35|12@0+ (0.01,-20.48) [0|0] "N m" A

BO_ 3 Clear: 1 A
 SG_ What : 0|8@1+ (1,0) [0|0] "" B

BO_ 4 Error: 2 B
 SG_ Code : 0|16@1+ (1,0) [0|0] "" A
"""
"""A motor with packed position, gains and torque; its orders share the bits of the target."""


def special(last: int) -> dict[str, str | int | float]:
    """Return the signals of a frame of FFh that ends in one other byte."""
    return {
        "Command.Pos": 0xFFFF,
        "Command.Vel": 0xFFF,
        "Command.Kp": 0xFFF,
        "Command.Kd": 0xFFF,
        "Command.Torque": 0xF00 | last,
    }


GAINS = {"Command.Vel": 2250, "Command.Kp": 800, "Command.Kd": 800}
MOTOR_MAP = DbcMap(
    inputs=Inputs(
        position=Quantity("Reply.Pos"),
        velocity=Quantity("Reply.Vel"),
        torque=Quantity("Reply.Torque"),
        fault_code=Quantity("Error.Code"),
    ),
    status=Status("Reply.State", {"disabled": (0,), "running": (1,)}, asked=True),
    target=Quantity("Command.Pos"),
    orders=Orders(
        disable=special(0xFD),
        stop=special(0xFD),
        reset={**special(0xFD), "Clear.What": 7},
        enable={"disabled": special(0xFC), "running": {**GAINS, "Command.Torque": 2048}},
    ),
    stop_frame=StopFrame("Command", {k.partition(".")[2]: v for k, v in special(0xFD).items()}),
)


def layouts(folder: Path, text: str) -> dict[str, Layout]:
    """Write and read a DBC file with these messages."""
    path = folder / "drive.dbc"
    path.write_text(HEAD + text)
    return read_dbc(path)


def wired(folder: Path, spec: DbcMap = MOTOR_MAP, text: str = MOTOR) -> Wiring:
    """Bind a map to the text of a DBC."""
    return bind(spec, layouts(folder, text))


def ordered(spec: DbcMap = MOTOR_MAP, **orders: object) -> DbcMap:
    """Return a map with other orders."""
    return replace(spec, orders=replace(spec.orders, **orders))  # type: ignore[arg-type]
