"""What the docstring of a record says of its fields: text, unit, inheritance."""

from __future__ import annotations

from rig.cli.authoring.schema import Meaning, meanings, summary, unit_of


class Parent:
    """A record.

    With a second paragraph.

    Attributes:
        length: Length at rest, m.
        speed_deg_s: Highest speed.
        share: Share of the whole, without unit.

    Raises:
        ValueError: Not a field.
    """


class Child(Parent):
    """A longer record.

    Attributes:
        length: Length at rest, mm in fact, m. Kept in ``metres`` of 9.80665
            steps: two lines.
        pause: s
    """


def test_the_unit_is_the_end_of_the_first_sentence_or_of_the_name() -> None:
    found = meanings(Parent)
    assert found["length"] == Meaning("Length at rest.", "m")
    assert found["speed_deg_s"] == Meaning("Highest speed.", "deg/s")
    assert found["share"] == Meaning("Share of the whole, without unit.", "")
    assert "ValueError" not in found


def test_a_child_says_more_and_keeps_the_rest() -> None:
    found = meanings(Child)
    assert found["length"] == Meaning(
        "Length at rest, mm in fact. Kept in `metres` of 9.80665 steps: two lines.", "m"
    )
    assert set(found) == {"length", "speed_deg_s", "share", "pause"}
    assert found["pause"].unit == "s"


def test_a_summary_ends_where_the_fields_begin() -> None:
    assert summary(Parent.__doc__ or "") == "A record.\n\nWith a second paragraph."


def test_the_longest_ending_of_a_name_is_its_unit() -> None:
    names = (
        "torque_constant_N_m_A",
        "back_emf_V_s_rad",
        "sigma_2_N_m_s_rad",
        "torque_N_m",
        "cycle_Hz",
        "kind",
    )
    assert [unit_of(name) for name in names] == ["N m/A", "V s/rad", "N m s/rad", "N m", "Hz", ""]
