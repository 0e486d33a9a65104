"""XDD files (CiA 311) describe a device as an EDS file does, and are read safely."""

import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest
from canopen.objectdictionary import ODVariable
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen import eds_file
from drivers.canopen.eds_file import Described, read_eds, sections
from drivers.errors import ConfigurationError
from drivers.mock.drive import DRIVE_EDS
from drivers.mock.encoder import ENCODER_EDS
from drivers.mock.traits import MAKES
from tests.drivers.makes import description

from .eds_shapes import of
from .host import enabled, make_host

HEAD = """\
<?xml version="1.0" encoding="utf-8"?>
<ISO15745ProfileContainer xmlns="http://www.canopen.org/xml/1.0">
<ISO15745Profile><ProfileBody><DeviceIdentity><vendorID>{vendor}</vendorID>
<productID>{product}</productID></DeviceIdentity>{parameters}</ProfileBody></ISO15745Profile>
<ISO15745Profile><ProfileBody><ApplicationLayers><CANopenObjectList>
"""
TAIL = """\
</CANopenObjectList></ApplicationLayers></ProfileBody></ISO15745Profile>
</ISO15745ProfileContainer>
"""
ATTRIBUTES = {
    "parametername": "name",
    "accesstype": "accessType",
    "defaultvalue": "defaultValue",
    "lowlimit": "lowLimit",
    "highlimit": "highLimit",
}


def written(text: str, parameters: str = "") -> str:
    """Return the XDD file that describes the device of an EDS file."""
    found = sections(text)
    info = found["DEVICEINFO"]
    lines = [
        HEAD.format(
            vendor=info.text("VendorNumber"),
            product=info.text("ProductNumber"),
            parameters=parameters,
        )
    ]
    for name, section in found.items():
        if not re.fullmatch("[0-9A-F]{4}", name):
            continue
        members = [
            (found[f"{name}SUB{sub:X}"], sub) for sub in range(256) if f"{name}SUB{sub:X}" in found
        ]
        close = "" if members else "/"
        lines.append(f"<CANopenObject index={quoteattr(name)} {shown(section)}{close}>\n")
        lines += [
            f'<CANopenSubObject subIndex="{sub:02X}" {shown(member)}/>\n' for member, sub in members
        ]
        lines += ["</CANopenObject>\n"] if members else []
    return "".join([*lines, TAIL])


def shown(section: object) -> str:
    values: dict[str, tuple[str, int]] = section.values  # type: ignore[attr-defined]
    parts = [
        f"{attribute}={quoteattr(values[key][0])}"
        for key, attribute in ATTRIBUTES.items()
        if key in values
    ]
    kind = int(values.get("objecttype", ("7", 0))[0], 0)
    parts.append(f'objectType="{kind}"')
    if "datatype" in values:
        parts.append(f'dataType="{int(values["datatype"][0], 0):04X}"')
    mapped = values.get("pdomapping", ("0", 0))[0] == "1"
    parts.append(f'PDOmapping="{"optional" if mapped else "no"}"')
    return " ".join(parts)


def objects(dictionary: Described) -> Iterator[tuple[int, int, object]]:
    for item in dictionary.values():
        for variable in [item] if isinstance(item, ODVariable) else item.values():
            yield variable.index, variable.subindex, (variable.name, of(variable))


@pytest.fixture
def xdd(tmp_path: Path) -> Path:
    return tmp_path / "own.xdd"


@pytest.mark.parametrize(
    "text",
    [DRIVE_EDS.read_text(), ENCODER_EDS.read_text(), *(description(make) for make in MAKES)],
    ids=["drive", "encoder", *MAKES],
)
def test_a_device_is_the_same_by_either_file(tmp_path: Path, text: str) -> None:
    eds, xdd = tmp_path / "own.eds", tmp_path / "own.xdd"
    eds.write_text(text)
    xdd.write_text(written(text))
    expected, found = read_eds(eds, 5), read_eds(xdd, 5)
    assert list(objects(found)) == list(objects(expected))
    assert len(list(objects(found))) > 20
    assert found.identity == expected.identity
    assert found.faults == expected.faults == {}


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_drive_runs_by_its_xdd_file(xdd: Path, encoding: str) -> None:
    name = encoding.removesuffix("-sig")
    text = written(DRIVE_EDS.read_text()).replace('encoding="utf-8"', f'encoding="{name}"')
    xdd.write_bytes(text.encode(encoding))
    host = enabled(make_host(eds=xdd))
    host.cycles(50)
    assert host.servo.sample().fresh
    host.servo.disable()


def test_an_object_may_refer_to_a_parameter(xdd: Path) -> None:
    parameters = (
        '<ApplicationProcess><parameterList><parameter uniqueID="P1" access="read"><DINT/>'
        '<defaultValue value="-7"/></parameter></parameterList></ApplicationProcess>'
    )
    head = HEAD.format(vendor="0x1", product="0x2", parameters=parameters)
    body = '<CANopenObject index="6064" name="Position" objectType="7" uniqueIDRef="P1"/>'
    xdd.write_text(head + body + TAIL)
    (variable,) = read_eds(xdd, 1).values()
    assert (variable.data_type, variable.access_type, variable.default) == (4, "ro", -7)


BOMB = (
    '<!DOCTYPE a [<!ENTITY x "xxxxxxxxxx"><!ENTITY y "&x;&x;&x;&x;&x;&x;">]>\n<a>&y;&y;&y;&y;</a>'
)


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (BOMB, 1),
        ('\n<!DOCTYPE a SYSTEM "file:///etc/hostname">\n<a/>', 2),
        (HEAD.format(vendor="1", product="1", parameters="") + "<CANopenObject", 6),
        (HEAD.replace("</vendorID>", "").format(vendor="1", product="1", parameters=""), 4),
        (HEAD.format(vendor="1", product="1", parameters="") + '<CANopenObject index="60G4"/>', 6),
        (HEAD.format(vendor="1", product="1", parameters="") + "<CANopenObject/>", 6),
        ("<a/>", 1),
        (HEAD.format(vendor="1", product="1", parameters="") + TAIL, 1),
    ],
    ids=["bomb", "external", "cut", "nesting", "index", "no index", "other", "empty"],
)
def test_a_file_that_cannot_be_used_is_refused_with_its_line(xdd, content, line):
    xdd.write_text(content)
    with pytest.raises(ConfigurationError, match=rf"own\.xdd:{line}: "):
        read_eds(xdd, 5)


def test_an_object_without_a_type_is_a_fault_with_its_line(xdd: Path) -> None:
    head = HEAD.format(vendor="1", product="1", parameters="")
    good = '<CANopenObject index="6041" name="S" objectType="7" dataType="0006"/>\n'
    xdd.write_text(head + good + '<CANopenObject index="6064" name="P" objectType="7"/>\n' + TAIL)
    assert read_eds(xdd, 5).faults[0x6064, 0].startswith(f"{xdd}:7: ")


def test_a_file_that_is_too_large_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(eds_file, "MOST_BYTES", 1000)
    xdd = tmp_path / "own.xdd"
    xdd.write_text("<a>" + " " * 2000 + "</a>")
    with pytest.raises(ConfigurationError, match="limit 1000"):
        read_eds(xdd, 5)


WHOLE = written(ENCODER_EDS.read_text()).encode()


@given(
    edits=st.lists(
        st.tuples(st.integers(0, len(WHOLE) - 1), st.integers(0, 40), st.binary(max_size=12)),
        max_size=4,
    )
)
def test_a_damaged_file_is_refused_or_describes_objects(tmp_path_factory, edits):
    content = WHOLE
    for at, length, replacement in edits:
        content = content[:at] + replacement + content[at + length :]
    xdd = tmp_path_factory.mktemp("xdd") / "own.xdd"
    xdd.write_bytes(content)
    with suppress(ConfigurationError):
        found = read_eds(xdd, 5)
        assert len(found)
        for index, subindex, _ in objects(found):
            assert 0 <= index <= 0xFFFF
            assert 0 <= subindex <= 0xFF
