"""How sure a result is, and the tables of parameters."""

import json
from dataclasses import replace

import numpy as np
import pytest

from identification.result import (
    Fit,
    Identification,
    MeasuredNoise,
    Parameter,
    Profile,
    Resampled,
    Starts,
    Tradeoff,
)
from rig.common.tables import interval, number, percent
from rig.results.identify.document import (
    bootstrap_table,
    determined_notes,
    note,
    parameter_table,
    profile_table,
    uncertainty_tables,
)

RESULT = Identification(
    "default",
    "rotary",
    2.0,
    {
        "Mc": Parameter("Mc", "N m", 7.0, 6.9, 7.1),
        "J": Parameter("J", "kg m^2", None, identifiable=False, at_bound=True, reason="no motion"),
    },
    Fit("N m", 40.0, 0.1, 0.01),
    (),
    fitted={"Mc": 7.0, "J": 0.0},
    starts=(
        Starts("unloaded", "defect", (20.0, 1.0), 3.0, absolute=True),
        Starts("loaded", "-2 log likelihood", (-90.0, -100.0, -99.5), -99.0),
    ),
    tradeoffs=(Tradeoff(("Mc", "sigma_2"), -0.95, "Mc and sigma_2 trade off"),),
    least_pinned="least determined is Mc alone",
    noise=MeasuredNoise(0.07, 0.06, 0.0095, 1e-6, 2e-5, "N m"),
    profiles=(
        Profile("Mc", "N m", np.array([6.8, 7.0, 7.4]), np.array([4.0, 0.0, 4.0]), 6.9, 7.3, 0.5),
        Profile("J", "kg m^2", np.array([0.0, 0.1]), np.array([0.0, np.inf]), None, 0.05, 1.0),
    ),
    resampled=(
        Resampled("Mc", "N m", 6.95, 7.08, 100, 98),
        Resampled("J", "kg m^2", None, None, 100, 3),
    ),
)


def test_ranges_stand_beside_intervals_and_open_ones_say_so() -> None:
    both, open_below = profile_table(RESULT).rows
    assert both == ("Mc", "[6.9, 7.1]", "[6.9, 7.3]", "3", "0.5", "N m")
    assert open_below == ("J", "-", "[< 0, 0.05]", "-", "1", "kg m^2")


def test_draws_stand_beside_intervals() -> None:
    assert bootstrap_table(RESULT).rows == (
        ("Mc", "[6.9, 7.1]", "[6.95, 7.08]", "98 of 100", "N m"),
        ("J", "-", "-", "3 of 100", "kg m^2"),
    )
    assert len(uncertainty_tables(RESULT)) == 2


@pytest.mark.parametrize(
    ("name", "half", "determined"), [("Mc", 3.4, True), ("Mc", 3.6, False), ("offset", 99.0, True)]
)
def test_the_interval_as_printed_decides_what_is_determined(
    name: str, half: float, determined: bool
) -> None:
    wide = Parameter(name, "N m", 7.0, 7.0 - half, 7.0 + half)
    assert wide.determined is determined
    assert bool(note(wide)) is not determined
    parameters = {"J": Parameter("J", "kg m^2", 1.0, 0.9, 1.1), name: wide}
    (line,) = determined_notes([replace(RESULT, parameters=parameters)])
    assert f"{1 + determined} of 2 parameters" in line


def test_the_record_is_json_without_infinities() -> None:
    record = json.loads(json.dumps(RESULT.to_dict(), allow_nan=False))
    assert record["bounds_hit"] == ["J"]
    assert record["tradeoffs"][0]["names"] == ["Mc", "sigma_2"]
    assert [s["reached_best"] for s in record["starts"]] == [1, 2]
    assert record["profiles"]["J"]["deviance"] == [0.0, None]
    assert record["profiles"]["Mc"]["high"] == 7.3
    assert record["bootstrap"]["J"] == {
        "unit": "kg m^2",
        "low": None,
        "high": None,
        "draws": 100,
        "solved": 3,
    }


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
