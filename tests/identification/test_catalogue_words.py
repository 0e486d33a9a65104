"""The catalogue's words: every name once, parameters that the sentence can print, look-alikes that
exist.
"""

import ast
from pathlib import Path
from string import Formatter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.diagnosis.result import Estimate
from identification.diagnosis.statement import finding, readable, sentence
from identification.effects import EFFECTS
from identification.effects.effect import Effect


def middle(entry: Effect) -> dict[str, Estimate]:
    """Estimates in the upper half of each plausible range."""
    found = {}
    for q in entry.parameters:
        value = q.low + 0.7 * (q.high - q.low)
        found[q.name] = Estimate(
            value, value - 0.01 * (q.high - q.low), value + 0.01 * (q.high - q.low), q.unit
        )
    return found


def test_a_value_of_zero_is_not_printed_where_the_words_say_so() -> None:
    """A single end stop has one angle, a pair has two."""
    entry = EFFECTS["end_stop"]
    estimates = middle(entry) | {"other_rad": Estimate(0.0, 0.0, 0.0, "rad")}
    assert sentence(entry, estimates).count(" deg") == 1
    assert sentence(entry, middle(entry)).count(" deg") == 2


@pytest.mark.parametrize("entry", EFFECTS.values(), ids=lambda e: e.name)
def test_an_entry_is_whole(entry: Effect) -> None:
    assert entry.shows_in in ("torque", "transmission", "voltage", "breakaway", "pressure")
    assert entry.look_alikes, "an effect without a look-alike needs no experiment"
    assert entry.name not in entry.look_alikes
    assert set(entry.look_alikes) <= set(EFFECTS)
    for q in entry.parameters:
        assert q.low < q.high, q.name
    named = {name for _, name, _, _ in Formatter().parse(entry.sentence) if name}
    assert (
        {q.name for q in entry.parameters}
        <= named
        <= {q.name for q in entry.parameters} | {"recordings", "channel"}
    )


@pytest.mark.parametrize("entry", EFFECTS.values(), ids=lambda e: e.name)
def test_a_finding_prints_every_value_in_a_unit_that_its_own_can_be_turned_into(entry):
    estimates = middle(entry)
    words = finding(entry, estimates, ("loaded_2",))
    assert "{" not in words
    assert entry.assumption in words
    for _, name, form, _ in Formatter().parse(entry.sentence):
        if name in estimates and form and not form.startswith("?"):
            unit = form.rpartition("|")[2].removeprefix("abs ")
            assert f" {unit} (" in words, f"{name} is not printed in {form}"


def test_a_missing_estimate_is_an_error_not_a_gap_in_the_sentence() -> None:
    with pytest.raises(KeyError, match="gap_rad"):
        sentence(EFFECTS["backlash"], {})


@given(value=st.floats(1e-6, 1e5), share=st.floats(1e-4, 0.9))
def test_what_is_printed_lies_within_a_third_of_the_interval_from_what_was_found(value, share):
    width = 2.0 * share * value
    words = readable(Estimate(value, value - width / 2, value + width / 2, "N m"))
    printed, low, high = (
        float(words.split(" N m")[0]),
        float(words.split("(")[1].split(" to")[0]),
        float(words.split("to ")[1].rstrip(")")),
    )
    slack = max(width / 3, 1e-3 * value)
    assert abs(printed - value) <= slack
    assert abs(low - (value - width / 2)) <= slack
    assert abs(high - (value + width / 2)) <= slack


SIMULATED = ("drivers/mock/", "rig/results/prove/", "rig/config/faults.py", "rig/fault_injection/")
"""Where effects are injected: the simulated machine, blind trials on it, and faults of a simulated
bench. It is written separately from the diagnosis, so that finding an effect proves something.
"""


def test_nothing_but_the_effects_and_the_simulated_machine_names_an_effect() -> None:
    root = Path(__file__).parents[2]
    # A load that a recording may declare may have the name of its key.
    names = {e.name for e in EFFECTS.values() if e.name != e.declared_by}
    found = []
    for file in (
        f for top in ("identification", "rig", "drivers") for f in (root / top).rglob("*.py")
    ):
        place = file.relative_to(root).as_posix()
        if not place.startswith(("identification/effects/", *SIMULATED)):
            texts = (
                n for n in ast.walk(ast.parse(file.read_text())) if isinstance(n, ast.Constant)
            )
            found += [f"{place}:{n.lineno} {n.value}" for n in texts if n.value in names]
    assert found == []
