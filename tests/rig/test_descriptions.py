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


def test_text_and_unit_come_from_the_docstring_or_from_the_name() -> None:
    share = Meaning("Share of the whole, without unit.", "")
    of_parent = {"speed_deg_s": Meaning("Highest speed.", "deg/s"), "share": share}
    assert meanings(Parent) == {"length": Meaning("Length at rest.", "m"), **of_parent}
    text = "Length at rest, mm in fact. Kept in `metres` of 9.80665 steps: two lines."
    assert meanings(Child) == {
        **of_parent,
        "length": Meaning(text, "m"),
        "pause": Meaning("", "s"),
    }
    assert summary(Parent.__doc__ or "") == "A record.\n\nWith a second paragraph."


def test_the_longest_ending_of_a_name_is_its_unit() -> None:
    names = ("torque_constant_N_m_A", "sigma_2_N_m_s_rad", "torque_N_m", "cycle_Hz", "kind")
    assert [unit_of(name) for name in names] == ["N m/A", "N m s/rad", "N m", "Hz", ""]
