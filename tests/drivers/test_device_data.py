"""What is known of makers' drives: the packaged files, and files that say something wrong."""

from pathlib import Path

import pytest
import yaml

from drivers.canopen.device_data import FOLDER, devices, identity, match, parse
from drivers.canopen.eds_file import read_eds
from drivers.mock.traits import MAKES
from tests.drivers.makes import description

from .host import make_eds

GOOD = "name: x\nsource: manual\nvendor_id: 0x12\n"
OF = {
    "EPOS4": "maxon_epos4", "EPOS2": "maxon_epos2", "Elmo": "elmo_gold", "Trinamic": "trinamic",
    "Faulhaber": "faulhaber",
    "Schunk": None, "Nanotec": "nanotec", "Copley": "copley", "Technosoft": "technosoft",
}  # fmt: skip


@pytest.mark.parametrize("make", MAKES)
def test_the_identity_in_an_eds_leads_to_the_maker(make: str, tmp_path: Path) -> None:
    eds = make_eds(tmp_path, make)
    name = OF[make]
    assert match(read_eds(eds, 1)) is (None if name is None else devices()[name])


@pytest.mark.parametrize("make", [make for make, name in OF.items() if name])
def test_the_simulated_make_has_the_units_that_its_maker_is_known_for(make: str) -> None:
    data, traits = devices()[OF[make] or ""], MAKES[make]
    assert data.vendor_id == traits.vendor_id
    own = {shown.address: shown for shown in traits.own}
    for kind, unit in (
        ("current_object", "current_unit_A"),
        ("supply_object", "supply_unit_V"),
        ("temperature_object", "temperature_unit_C"),
        ("rated_current_object", "rated_current_object_unit_A"),
    ):
        address = getattr(data, kind)
        if address is not None:
            assert own[address].unit == pytest.approx(getattr(data, unit))
    assert traits.rated_torque_unit_N_m == (data.rated_torque_object_unit_N_m or 1e-3)
    assert traits.rpm is (data.velocity_unit == "rpm")
    if not traits.rpm:
        counts = data.velocity_unit_counts_per_s or 1.0
        assert traits.speed_counts_per_s == pytest.approx(counts)
    assert traits.acceleration_counts_s2 == data.acceleration_unit_counts_per_s2
    assert traits.acceleration_turns_s2 == data.acceleration_unit_turns_per_s2


def test_families_of_one_vendor_differ_by_their_objects(tmp_path: Path) -> None:
    eds = tmp_path / "drive.eds"
    eds.write_text(description("EPOS4").replace("[30D1sub2]", "[40D1sub2]"))
    assert match(read_eds(eds, 1)) is None


def test_an_identity_in_the_header_alone_is_found(tmp_path: Path) -> None:
    eds = tmp_path / "drive.eds"
    eds.write_text(description("Elmo").replace("DefaultValue=0x0000009A", "DefaultValue="))
    assert identity(read_eds(eds, 1)) == (0x9A, 0x30923)
    eds.write_text(eds.read_text().replace("VendorNumber=0x0000009A", "VendorNumber=unknown"))
    assert identity(read_eds(eds, 1)) == (None, 0x30923)
    assert match(read_eds(eds, 1)) is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (GOOD + "velocity: rpm\n", "velocity"),
        (GOOD + "velocity_unit: rpms\n", "velocity_unit"),
        (GOOD + "current_object: [0x6078, 0]\n", "current_unit_A is the unit of current_object"),
        (GOOD + "supply_object: [0x12345, 0]\nsupply_unit_V: 1\n", "supply_object"),
        (GOOD + "velocity_unit: rpm\nvelocity_unit_counts_per_s: 1\n", "are both set"),
        (GOOD + "current_object: [1, 0]\ncurrent_unit_A: -1e-3\n", "greater than 0"),
        ("name: !!python/object:os.system {}\n", "could not determine a constructor"),
        ("name: [", "expected"),
        ("", "valid dictionary"),
    ],
)
def test_a_file_that_says_something_wrong_is_refused(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        parse(text)


def test_numbers_with_an_exponent_are_numbers() -> None:
    assert parse(GOOD + "current_object: [1, 0]\ncurrent_unit_A: 1e-3\n").current_unit_A == 1e-3


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.yaml")), ids=lambda path: path.stem)
def test_no_key_of_a_file_appears_twice(path: Path) -> None:
    keys = [key.value for key, _ in yaml.compose(path.read_text(encoding="utf-8")).value]
    assert len(set(keys)) == len(keys)
