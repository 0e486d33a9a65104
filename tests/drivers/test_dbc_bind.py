from dataclasses import replace
from pathlib import Path

import pytest

from drivers.dbc.bind import bind
from drivers.dbc.file import DbcMapError, read_dbc
from drivers.dbc.map import DbcMap, Protection, Quantity, Status, StopFrame
from drivers.errors import ConfigurationError
from drivers.interfaces import ServoState
from drivers.mock.dbc_drive import DRIVE_DBC

from .dbc_host import MAP, ORDER

LAYOUTS = read_dbc(DRIVE_DBC)
STATES = MAP.status.states


def problems(spec: DbcMap) -> dict[str, str]:
    with pytest.raises(DbcMapError) as caught:
        bind(spec, LAYOUTS)
    return {".".join(map(str, place)): text for place, text in caught.value.problems}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "own.dbc"


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


def test_a_syntax_error_names_line_and_column(path: Path) -> None:
    path.write_text(DRIVE_DBC.read_text().replace("SG_ Code :", "SG_ Code"))
    with pytest.raises(ConfigurationError, match=r"own\.dbc:10:11: Invalid syntax"):
        read_dbc(path)


@pytest.mark.parametrize(
    ("good", "bad", "words"),
    [
        ("Life : 4|4@1+", "Life : 3|4@1+", "overlapping in message DRV_Command"),
        ("Life : 4|4@1+", "Life : 62|4@1+", "does not fit in message DRV_Command"),
    ],
)
def test_a_message_whose_bits_are_wrong_is_not_used_and_others_are(path, good, bad, words):
    text = DRIVE_DBC.read_text()
    assert good in text
    path.write_text(text.replace(good, bad))
    layouts, right = read_dbc(path), read_dbc(DRIVE_DBC)
    assert words in layouts["DRV_Command"].obstacle
    assert {name: one for name, one in layouts.items() if name != "DRV_Command"} == {
        name: one for name, one in right.items() if name != "DRV_Command"
    }


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(
        ConfigurationError, match=r"none\.dbc: the file cannot be read: No such file"
    ):
        read_dbc(tmp_path / "none.dbc")


@pytest.mark.parametrize(
    ("comment", "encoding"),
    [
        ("电流", "utf-16"),
        # The second byte of each is a backslash, before the quote that ends the comment.
        ("\u8868", "shift-jis"),
        ("\u4fd3", "gb18030"),
        ("\u529f", "big5"),
    ],
)
def test_comments_are_read_in_any_encoding(path: Path, comment: str, encoding: str) -> None:
    text = DRIVE_DBC.read_text().replace("Mean since the last command.", comment)
    path.write_bytes(text.encode(encoding))
    assert read_dbc(path) == read_dbc(DRIVE_DBC)


def test_a_message_that_is_defined_twice_is_not_used(path, capfd):
    text = DRIVE_DBC.read_text()
    path.write_text(text.replace("BO_ 288 DRV", "BO_ 16 DRV_Stop: 2 HOST\n\nBO_ 288 DRV"))
    layouts = read_dbc(path)
    assert "is defined twice" in layouts["DRV_Stop"].obstacle
    assert not layouts["DRV_Limits"].obstacle
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("period", ["-5", '"soon"', "0"])
def test_a_cycle_time_that_is_none_counts_as_none(path: Path, period: str) -> None:
    text = DRIVE_DBC.read_text().replace("INT 0 65535", "STRING")
    path.write_text(text.replace("BO_ 416 100;", f"BO_ 416 {period};"))
    assert read_dbc(path)["DRV_Status"].period_s is None


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("BO_ 5 M: 16 A", "16 bytes; a classical CAN frame has at most 8"),
        (
            'BO_ 5 M: 8 A\n SG_ K M : 0|8@1+ (1,0) [0|0] "" B\n'
            ' SG_ L m0M : 8|8@1+ (1,0) [0|0] "" B\n SG_ X m1 : 16|8@1+ (1,0) [0|0] "" B\n\n'
            "SG_MUL_VAL_ 5 L K 0-0;\nSG_MUL_VAL_ 5 X L 1-1;",
            "is multiplexed by more than one signal (K, L)",
        ),
        (
            'BO_ 5 M: 8 A\n SG_ H : 0|16@1- (1,0) [0|0] "" B\n\nSIG_VALTYPE_ 5 H : 1;',
            "not of 32 or 64 bits: H",
        ),
    ],
)
def test_what_cannot_be_used_says_why(path: Path, lines: str, words: str) -> None:
    path.write_text(f'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: A B\n\n{lines}\n')
    assert words in read_dbc(path)["M"].obstacle
