"""Who wins over the target, what goes once, what is a fault."""

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.dbc.channel import DbcChannel
from drivers.dbc.file import DbcMapError
from drivers.dbc.map import DbcMap, Protection, Quantity, StopFrame
from drivers.errors import DriveFault
from drivers.interfaces import ServoState

from .dbc_texts import GAINS, MOTOR, MOTOR_MAP, ordered, special, wired

S = ServoState
COMMAND, CLEAR = 1, 3
GUARDED = MOTOR.replace(
    "BO_ 3 Clear: 1 A\n",
    'BO_ 3 Clear: 3 A\n SG_ Life : 8|4@1+ (1,0) [0|0] "" B\n SG_ Sum : 16|8@1+ (1,0) [0|0] "" B\n',
)


def problems(folder: Path, spec: DbcMap, text: str = MOTOR) -> dict[str, str]:
    with pytest.raises(DbcMapError) as caught:
        wired(folder, spec, text)
    return {".".join(map(str, place)): words for place, words in caught.value.problems}


def sent(channel: DbcChannel, *, all_now: bool = False) -> list[tuple[int, str]]:
    return [(identifier, data.hex()) for identifier, data in channel.frames(all_now=all_now)]


def hear(channel: DbcChannel, identifier: int, data: bytes) -> None:
    channel.receive(channel.slots[identifier], data, 0)


def test_a_running_drive_must_get_its_target(tmp_path: Path) -> None:
    enable = {"disabled": special(0xFC), "running": {**GAINS, "Command.Pos": 5}}
    found = problems(tmp_path, ordered(enable=enable))
    assert "a running drive would never receive a target" in found["orders.enable.running"]


@pytest.mark.parametrize(
    ("signal", "words"), [("Clear.Life", "counter"), ("Clear.Sum", "checksum")]
)
def test_what_the_program_fills_in_is_no_order(tmp_path: Path, signal: str, words: str) -> None:
    spec = replace(
        ordered(reset={**special(0xFD), signal: 1}),
        messages={"Clear": Protection("Life", "Sum", "sum8")},
    )
    found = problems(tmp_path, spec, GUARDED)
    assert f"overlaps the {words} of message 'Clear'" in found[f"orders.reset.{signal}"]


def test_an_order_that_the_bus_refused_stays_due(tmp_path: Path) -> None:
    wiring = wired(tmp_path)
    channel = DbcChannel(wiring, "the motor")
    channel.order(wiring.reset)
    for identifier, _ in channel.frames():
        if identifier == CLEAR:
            break  # The link raised here.
    assert (CLEAR, "07") in sent(channel)
    assert (CLEAR, "07") not in sent(channel)


def test_a_period_in_the_map_makes_it_cyclic(tmp_path: Path) -> None:
    wiring = wired(tmp_path, replace(MOTOR_MAP, messages={"Clear": Protection(period_ms=20)}))
    assert (set(wiring.sent), set(wiring.once)) == ({"Clear", "Command"}, set())


def test_a_cycle_time_of_the_dbc_alone_does_not(tmp_path: Path) -> None:
    """Editors write it, or its default, for messages of every kind."""
    text = MOTOR + (
        '\nBA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;\nBA_DEF_DEF_ "GenMsgCycleTime" 100;\n'
    )
    assert set(wired(tmp_path, text=text).once) == {"Clear"}


def test_a_stop_frame_counts_with_the_commands_and_has_its_checksum(tmp_path: Path) -> None:
    spec = replace(
        ordered(reset={**special(0xFD)}),
        stop_frame=StopFrame("Clear", {"What": 9}),
        messages={"Clear": Protection("Life", "Sum", "sum8")},
    )
    channel = DbcChannel(wired(tmp_path, spec, GUARDED), "the motor")
    assert [channel.stop_frame() for _ in range(2)] == [
        (CLEAR, bytes([9, 1, 10])),
        (CLEAR, bytes([9, 2, 11])),
    ]


def test_a_stop_frame_in_the_message_of_the_commands_keeps_its_counter(tmp_path: Path) -> None:
    spec = replace(
        ordered(reset={**special(0xFD), "Clear.What": 7}),
        stop_frame=StopFrame("Clear", {"What": 9}),
        messages={"Clear": Protection("Life", period_ms=0)},
    )
    channel = DbcChannel(wired(tmp_path, spec, GUARDED), "the motor")
    lives = [dict(channel.frames())[CLEAR][1], channel.stop_frame()[1][1]]
    assert [*lives, dict(channel.frames())[CLEAR][1]] == [1, 2, 3]


@pytest.mark.parametrize(
    ("state", "code", "shown"),
    [
        (0, 0, S.SWITCH_ON_DISABLED),
        (0, 7, S.FAULT),
        (1, 0, S.OPERATION_ENABLED),
        (1, 7, S.FAULT_REACTION),
        (99, 0, None),
        (99, 7, S.FAULT_REACTION),
    ],
)
def test_a_fault_code_is_a_fault_whatever_the_state_says(tmp_path, state, code, shown):
    channel = DbcChannel(wired(tmp_path), "the motor")
    hear(channel, 2, bytes([state, 0, 0, 0, 0, 0]))
    hear(channel, 4, code.to_bytes(2, "little"))
    assert channel.state is shown


def test_a_code_under_power_ends_the_run_of_the_drive(tmp_path: Path) -> None:
    wiring = wired(tmp_path)
    channel = DbcChannel(wiring, "the motor")
    hear(channel, 2, bytes([1, 0, 0, 0, 0, 0]))
    channel.order(wiring.enable[S.OPERATION_ENABLED], hold=True)
    channel.settle()
    hear(channel, 4, b"\x07\x00")
    with pytest.raises(DriveFault) as caught:
        channel.settle()
    assert caught.value.code == 7
    assert sent(channel)[0] == (COMMAND, "fffffffffffffffd")


def test_a_state_without_a_fault_code_must_show_faults(tmp_path: Path) -> None:
    spec = replace(MOTOR_MAP, inputs=replace(MOTOR_MAP.inputs, fault_code=None))
    assert "no value is stated for 'fault'" in problems(tmp_path, spec)["status.states"]


def test_a_torque_offset_goes_with_the_target_and_rests_without_it(tmp_path: Path) -> None:
    enable = {"disabled": special(0xFC), "running": GAINS}
    spec = replace(ordered(enable=enable), torque_offset=Quantity("Command.Torque"))
    wiring = wired(tmp_path, spec)
    channel = DbcChannel(wiring, "the motor")
    channel.push(wiring.torque_offset.bits(1.0))
    assert sent(channel)[0][1] == "fffffffffffffffd"
    channel.order(wiring.enable[S.OPERATION_ENABLED], hold=True)
    assert sent(channel)[0][1].endswith("800")  # 0 N m, not the lowest torque of the signal
    channel.push(wiring.torque_offset.bits(1.0))
    assert sent(channel)[0][1].endswith(f"{2048 + 100:03x}")
    channel.order(wiring.disable)
    channel.order(wiring.enable[S.OPERATION_ENABLED], hold=True)
    assert sent(channel)[0][1].endswith("800")


def test_an_order_beside_the_torque_offset_is_refused(tmp_path: Path) -> None:
    found = problems(tmp_path, replace(MOTOR_MAP, torque_offset=Quantity("Command.Torque")))
    assert "which the program writes" in found["orders.enable.running"]
