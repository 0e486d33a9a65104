from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.dbc.bind import bind
from drivers.dbc.file import DbcMapError, read_dbc
from drivers.dbc.map import DbcMap, Protection, Quantity, Status, StopFrame
from drivers.interfaces import ServoState
from drivers.mock.dbc_drive import DRIVE_DBC

from .dbc_host import MAP, ORDER

LAYOUTS = read_dbc(DRIVE_DBC)
STATES = MAP.status.states


def problems(spec: DbcMap) -> dict[str, str]:
    with pytest.raises(DbcMapError) as caught:
        bind(spec, LAYOUTS)
    return {".".join(map(str, place)): text for place, text in caught.value.problems}


def inputs(**changes: Quantity | None) -> DbcMap:
    return replace(MAP, inputs=replace(MAP.inputs, **changes))


def test_the_map_binds() -> None:
    wiring = bind(MAP, LAYOUTS)
    assert wiring.states[2] is ServoState.OPERATION_ENABLED
    assert (wiring.stop_message.identifier, wiring.stop_image) == (0x010, b"\xa5")
    assert not wiring.once
    assert set(wiring.sent) == {"DRV_Command"}
    assert set(wiring.settings) == {"DRV_Limits"}
    assert wiring.sampled == {"DRV_Motion", "DRV_Power", "DRV_Status"}
    assert wiring.disable.frames["DRV_Command"] == bytes(8)
    assert wiring.stop.frames["DRV_Command"] == b"\x03" + bytes(7)
    assert wiring.received["DRV_Status"].period_s == 0.1


def test_periods_of_the_map_go_before_those_of_the_dbc() -> None:
    messages = {**MAP.messages, "DRV_Status": Protection(period_ms=40)}
    assert bind(replace(MAP, messages=messages), LAYOUTS).received[
        "DRV_Status"
    ].period_s == pytest.approx(0.04)


@pytest.mark.parametrize(
    ("spec", "place", "words"),
    [
        (inputs(position=Quantity("DRV_Moton.Position")), "inputs.position.signal",
         "did you mean 'DRV_Motion'"),
        (inputs(position=Quantity("Position")), "inputs.position.signal",
         "must have the form Message.Signal"),
        (inputs(current=None), "inputs", "either current or torque"),
        (replace(MAP, status=Status("DRV_Motion.State", {**STATES, "ready": ("REDY",)})),
         "status.states.ready.0", "no value 'REDY'; did you mean 'READY'?"),
        (replace(MAP, status=Status("DRV_Motion.State", {**STATES, "ready": ("RUN",)})),
         "status.states.running.0", "is stated for two states"),
        (replace(MAP, status=Status("DRV_Motion.State", {"running": ("RUN",), "fault": (5,)})),
         "status.states", "no value is stated for 'disabled'"),
        (replace(MAP, messages={"DRV_Command": Protection(counter_last=14)}),
         "messages.DRV_Command.counter_last", "of a counter, but the message has no counter"),
        (replace(MAP, torque_offset=MAP.target), "torque_offset.signal",
         "bits in common with the target"),
        (inputs(velocity=Quantity("DRV_Power.Velocity", wraps_after=6.3)),
         "inputs.velocity.wraps_after", "is allowed for position and target only"),
        (replace(MAP, messages={"DRV_Command": Protection(remote=True)}),
         "messages.DRV_Command.remote", "is allowed for messages that the drive sends only"),
        (replace(MAP, stop_frame=StopFrame("DRV_Motion", {"State": 1})), "inputs",
         "'DRV_Motion' has two uses"),
        (replace(MAP, orders=replace(MAP.orders, stop={"DRV_Command.Ordr": 1})),
         "orders.stop.DRV_Command.Ordr", "did you mean 'Order'?"),
        (replace(MAP, orders=replace(MAP.orders, enable={"disabled": {ORDER: "READY"}})),
         "orders.enable", "for the state 'running', with which the drive continues to run"),
        (replace(MAP, stop_frame=StopFrame("DRV_Stop", {"Cod": 1})),
         "stop_frame.signals.Cod", "did you mean 'Code'?"),
        (replace(MAP, messages={"DRV_Motion": Protection(checksum="Life")}),
         "messages.DRV_Motion.checksum", "has 4 bits; a checksum must have 8"),
        (replace(inputs(serial_number=None, revision=None), messages={"DRV_Info": Protection()}),
         "messages.DRV_Info",
         "contains no signal of this map"),
    ],
)  # fmt: skip
def test_a_wrong_map_names_the_place_and_the_remedy(spec: DbcMap, place: str, words: str) -> None:
    assert words in problems(spec)[place]


def test_every_problem_is_told_at_once() -> None:
    wrong = inputs(position=Quantity("DRV_Motion.Postion"), velocity=Quantity("DRV_Powr.Velocity"))
    assert set(problems(replace(wrong, stop_frame=StopFrame("Stop")))) == {
        "inputs.position.signal",
        "inputs.velocity.signal",
        "stop_frame.message",
    }


def test_states_are_whole_numbers() -> None:
    motion = LAYOUTS["DRV_Motion"]
    real = {**motion.signals, "State": replace(motion.signals["State"], real=True)}
    with pytest.raises(DbcMapError) as caught:
        bind(MAP, {**LAYOUTS, "DRV_Motion": replace(motion, signals=real)})
    assert [place for place, _ in caught.value.problems] == [("status", "signal")]


def test_two_messages_of_one_identifier_are_refused() -> None:
    layouts = {**LAYOUTS, "DRV_Power": replace(LAYOUTS["DRV_Power"], identifier=0x190)}
    with pytest.raises(DbcMapError, match="'DRV_Motion' and 'DRV_Power' have one identifier"):
        bind(MAP, layouts)
