"""Aligned tables and the parameter table."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.result import Fit, Identification, Parameter
from rig.common.tables import interval, number, percent, table
from rig.results.identify.document import parameter_table

CELL = st.text(st.characters(codec="ascii", categories=("L", "N")), min_size=1, max_size=12)


@given(st.lists(st.tuples(CELL, CELL, CELL), max_size=6))
def test_columns_line_up(rows: list[tuple[str, str, str]]) -> None:
    lines = table(("name", "value", "unit"), rows, right=[1]).split("\n")
    assert len(lines) == 2 + len(rows)
    name_width, value_width, _ = (len(rule) for rule in lines[1].split("  "))
    for line, row in zip(lines[2:], rows, strict=True):
        assert line[:name_width].rstrip() == row[0]
        assert line[name_width + 2 : name_width + 2 + value_width].lstrip() == row[1]
        assert line[name_width + value_width + 4 :] == row[2]
        assert not line.endswith(" ")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (number(0.000204), "0.000204"),
        (number(6.82512345), "6.8251"),
        (number(None), "-"),
        (interval(1.0, 2.5), "[1, 2.5]"),
        (percent(16470.4), "16470 %"),
    ],
)
def test_numbers_in_words(text: str, expected: str) -> None:
    assert text == expected


def result(method: str, **parameters: Parameter) -> Identification:
    return Identification(method, "rotary", 2.0, parameters, Fit("N m", 40.0, 0.1, 0.01), ())


MC = Parameter("Mc", "N m", 6.9, 6.8, 7.0)
J = Parameter("J", "kg m^2", None, identifiable=False, reason="too slow")


def test_two_methods_and_the_truth() -> None:
    made = parameter_table(
        [result("default", Mc=MC, J=J), result("paper", Mc=Parameter("Mc", "N m", 7.5))],
        {"Mc": 7.5},
    )
    assert len(made.header) == len(made.rows[0]) == len(made.rows[1])
    cells = dict(zip(made.header, made.rows[0], strict=True))
    assert cells["true"] == "7.5"
    assert cells["paper: value"] == "7.5"
    assert cells["default: error"] == "-8 %"
    assert cells["paper: error"] == "0 %"
    assert "paper: 90 % interval" not in made.header  # this method has none
    assert made.rows[1][-1] == "default: not identifiable"


def test_a_value_that_rounds_to_zero_has_no_sign() -> None:
    assert number(-0.0) == "0"
    assert interval(-0.0, 0.0) == "[0, 0]"
    assert percent(-0.0) == "0 %"
