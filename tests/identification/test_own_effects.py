"""Effects of one's own: what a definition finds out, what is wrong with one, and its responses."""

import runpy
from pathlib import Path

import numpy as np
import pytest

import identification as lr
from identification.effects import EFFECTS, EffectError, OwnEffect, with_own
from identification.effects.model import CorrectedModel
from identification.effects.own import Seen, dimensions, sampled, samples_of
from identification.effects.prediction import Fitted, predict
from identification.numerics.spread import Spread
from identification.recording import Bench, Recording
from identification.views.nominal import Nominal
from identification.views.view import View, views

SIX = Path(__file__).parents[2] / "benchmarks" / "six_effects.py"
HEAD = """\
import numpy as np
from identification.effects.own import OwnEffect, effect
"""
TIME = np.arange(1500) / 500.0


@pytest.fixture(scope="module")
def six() -> dict[str, OwnEffect]:
    defined = runpy.run_path(str(SIX)).values()
    classes = [d for d in defined if isinstance(d, type) and issubclass(d, OwnEffect)]
    found = [d for d in defined if isinstance(d, OwnEffect)] + [c() for c in classes[1:]]
    return {e.name: e for e in found}


@pytest.fixture(scope="module")
def view() -> View:
    bench = Bench(torque_constant=0.03, gear_ratio=100.0, moment_arm=0.095, lever_ratio=10.0)
    angle = 0.3 * np.sin(3.0 * TIME) + 0.1 * np.sin(11.0 * TIME)
    channels = {"time": TIME, "angle": angle, "current": 4.0 * np.cos(3.0 * TIME)}
    return views(
        [Recording(name="r", channels=channels, bench=bench, stage="loaded", weight_mass=20.0)],
        50.0,
    )[0]


def defined(tmp_path: Path, text: str) -> dict[str, object]:
    path = tmp_path / "mine.py"
    path.write_text(HEAD + text)
    return runpy.run_path(str(path))


def refusal(tmp_path: Path, text: str) -> str:
    with pytest.raises(EffectError) as refused:
        defined(tmp_path, text)
    return str(refused.value)


def test_parameters_are_linear_or_searched_and_signals_are_known(six):
    found = {n: (e.coefficients, e.nonlinear, e.size) for n, e in six.items()}
    assert found == {
        "root_drag": (("c",), (), None),
        "cubic_spring": (("k",), (), None),
        "speed_resonance": (("torque",), ("speed", "width"), None),
        "loaded_drag": (("c",), (), None),
        "lagged_drag": (("c",), ("lag",), None),
        "seal_drag": (("torque",), ("travel",), None),
    }
    assert six["loaded_drag"].used == {"load", "velocity"}
    assert six["cubic_spring"].at_angle
    assert not six["root_drag"].at_angle
    assert all(e.positive == (0,) and e.enters == ("torque", "breakaway") for e in six.values())
    assert all(e.problems() == [] for e in six.values())


def test_the_trials_stay_within_the_range_and_the_search_little_beyond(six):
    entry = six["speed_resonance"]
    low = np.array([q.low for q in entry.parameters[1:]])
    high = np.array([q.high for q in entry.parameters[1:]])
    trials = np.array(entry.trials)
    assert 9 <= len(trials) <= 48
    assert np.all((trials > low) & (trials < high))
    for k, (least, most) in entry.limits.items():
        assert 0.0 < least < low[k] < high[k] < most < 1.1 * high[k]


def test_a_sign_is_that_of_the_range(tmp_path: Path) -> None:
    text = '@effect(c=("N m", {}, 2.0))\ndef push(s, p):\n    return p.c * s.direction\n'
    either, one = (defined(tmp_path, text.format(low))["push"] for low in (-2.0, 0.0))
    assert isinstance(either, OwnEffect)
    assert isinstance(one, OwnEffect)
    assert (either.positive, one.positive) == ((), (0,))


def test_two_coefficients_and_signals_of_the_model(tmp_path: Path, view: View) -> None:
    text = """
@effect(a=("", -1.0, 1.0), b=("N m s/rad", -9.0, 9.0))
def loss(s, p):
    return p.a * s.motor_torque + p.b * s.velocity
"""
    entry = defined(tmp_path, text)["loss"]
    assert isinstance(entry, OwnEffect)
    assert entry.coefficients == ("a", "b")
    assert entry.follows
    nominal = Nominal({"J": 0.2, "Mc": 5.0}, (), 2.0)
    rows = entry.columns["torque"](view, nominal, ())
    assert np.array_equal(rows, [nominal.drive(view), view.velocity])
    shape, coefficients = entry.at({"a": 0.3, "b": -2.0}, nominal)
    assert (shape, coefficients) == ((), (0.3, -2.0))
    assert entry.columns["breakaway"] is entry.columns["torque"]


def test_an_effect_without_a_coefficient_has_the_size_of_its_parameters(tmp_path: Path) -> None:
    text = """
@effect(w=("rad/s", 0.05, 2.0))
def fade(s, p):
    return s.motor_torque * np.tanh(s.velocity / p.w)
"""
    entry = defined(tmp_path, text)["fade"]
    assert isinstance(entry, OwnEffect)
    assert (entry.coefficients, entry.size, entry.positive) == ((), 1.0, (0,))
    assert entry.at({"w": 0.3}, Nominal({}, (), 2.0)) == ((0.3,), (1.0,))


def test_a_compiled_function_of_samples_is_that_of_python(six, view):
    nominal = Nominal({}, (), 2.0)
    for name in ("lagged_drag", "seal_drag"):
        entry = six[name]
        (fast,) = entry.columns["torque"](view, nominal, (0.1,))
        p = dict(zip((*entry.coefficients, *entry.nonlinear), (1.0, 0.1), strict=True))
        record = type("P", (), p)
        rows = samples_of(Seen(view, nominal), sorted(entry.used))
        plain = sampled(entry.functions["torque"].call, rows, entry.states, view.step, record)
        assert np.max(np.abs(plain)) > 0.05
        assert fast == pytest.approx(plain, abs=1e-12), name


def test_a_function_that_is_not_compiled_still_works(tmp_path, view, caplog):
    text = """
def helper(w):
    return w

@effect(c=("N m s/rad", 0.0, 5.0), states=1)
def helped(s, x, dt, p):
    x[0] = helper(s.velocity)
    return p.c * x[0]
"""
    entry = defined(tmp_path, text)["helped"]
    assert isinstance(entry, OwnEffect)
    (found,) = entry.columns["torque"](view, Nominal({}, (), 2.0), ())
    assert np.array_equal(found, view.velocity)
    assert "mine.py:7: helped: is not compiled" in caplog.text


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ('@effect()\ndef a(s, p):\n    return s.velocity\n', ":3: a: parameters:", "at least one"),
        ('@effect(c=("N m sec", 0, 1))\ndef a(s, p): ...\n', ":3: a: parameters: c:", "'sec'"),
        ('@effect(c=("N/m/s", 0, 1))\ndef a(s, p): ...\n', ":3: a: parameters: c:", "one '/'"),
        ('@effect(c=("N m", 2, 1))\ndef a(s, p): ...\n', ":3: a: parameters: c:", "2 to 1"),
        ('@effect(c=("N m", 0, np.inf))\ndef a(s, p): ...\n', ":3: a: parameters: c:", "inf"),
        ("@effect(c=5)\ndef a(s, p): ...\n", ":3: a: parameters: c:", "got 5"),
        ('@effect(c=("", 0, 1), enters="heat")\ndef a(s, p): ...\n', ":3: a: enters:", "voltage"),
        (
            '@effect(c=("", 0, 1))\ndef a(s, p):\n    return p.c * s.speed\n',
            ":5: a: AttributeError:", "velocity",
        ),
        (
            '@effect(c=("", 0, 1))\ndef a(s, p):\n    return p.c * np.sqrt(s.velocity)\n',
            ":3: a: torque returns nan at velocity =", "c = 0.35",
        ),
        (
            '@effect(c=("", 0, 1))\ndef a(s, p):\n    return p.c * s.velocity[1:]\n',
            ":3: a: torque must return", "(159,)",
        ),
        ('@effect(c=("", 0, 1), states=1)\ndef a(s, p): ...\n', ":3: a: TypeError:", "s, x, dt, p"),
        ('@effect(c=("", 0, 1))\ndef a(s, p):\n    return 0 * s.time\n', ":3: a:", "returns zero"),
        ('class A(OwnEffect):\n    parameters = {"c": ("", 0, 1)}\n', "A:", "transmission"),
    ],
)  # fmt: skip
def test_a_wrong_definition_is_refused_with_its_place(text, place, words, tmp_path):
    found = refusal(tmp_path, text)
    assert place in found
    assert words in found
    assert place.startswith("A") or found.startswith(str(tmp_path / "mine.py"))


def test_a_unit_that_does_not_fit_and_a_size_without_zero_are_found(tmp_path: Path) -> None:
    text = """
@effect(c=("N m s/rad", 0.0, 5.0))
def root(s, p):
    return p.c * s.velocity * np.abs(s.velocity) ** 0.5

@effect(c=("N m s/rad", 0.0, 5.0))
def shifted(s, p):
    return p.c * s.velocity + s.motor_torque

@effect(c=("N s/m", 0.0, 5.0))
def on_a_linear_bench(s, p):
    return p.c * s.velocity
"""
    found = {
        name: [p.partition(":")[0] for p in entry.problems()]
        for name, entry in defined(tmp_path, text).items()
        if isinstance(entry, OwnEffect)
    }
    assert found == {"root": ["units"], "shifted": ["zero"], "on_a_linear_bench": []}
    assert dimensions("N m s^1.5/rad^1.5") == {"kg": 1.0, "m": 2.0, "s": -0.5}
    assert dimensions("N m s/(A^2 rad)") == {"kg": 1.0, "m": 2.0, "s": -1.0, "A": -2.0}


@pytest.mark.parametrize("signal", ["angle", "friction"])
def test_a_function_cannot_change_the_signals(signal: str, view: View) -> None:
    seen = Seen(view, Nominal({"Mc": 2.0}, (), 2.0))
    before = getattr(seen, signal).copy()
    with pytest.raises(ValueError, match="read-only"):
        getattr(seen, signal)[:] = 0.0
    np.testing.assert_array_equal(getattr(seen, signal), before)
    assert view.angle.flags.writeable


def test_a_definition_that_changes_a_signal_is_refused(tmp_path: Path) -> None:
    text = """
@effect(c=("N m", -9, 9))
def mine(s, p):
    a = s.angle
    a *= 2.0
    return p.c * a
"""
    assert "read-only" in refusal(tmp_path, text)


@pytest.mark.parametrize(
    ("signal", "late"), [("angle", True), ("motor_angle", True), ("velocity", False)]
)
def test_an_effect_at_an_angle_is_as_late_as_the_torque(signal, late, tmp_path):
    text = f'@effect(c=("N m", -9, 9))\ndef mine(s, p):\n    return p.c * np.sin(s.{signal})\n'
    found = defined(tmp_path, text)["mine"]
    assert isinstance(found, OwnEffect)
    assert found.at_angle is late


def test_a_recording_without_a_signal_cannot_show_the_effect(tmp_path: Path, view: View) -> None:
    from identification.effects.effect import Context

    text = '@effect(c=("N m/V", 0, 1))\ndef a(s, p):\n    return p.c * s.voltage\n'
    entry = defined(tmp_path, text)["a"]
    assert isinstance(entry, OwnEffect)
    assert entry.shapes(Context((view,), Nominal({}, (), 2.0))) == ()


def test_the_catalogue_stays_as_it_is(six: dict[str, OwnEffect], tmp_path: Path) -> None:
    before = dict(EFFECTS)
    assert [*with_own([*six.values()])] == [*before, *six]
    assert before == EFFECTS
    text = '@effect(c=("", 0, 1))\ndef backlash(s, p):\n    return p.c * s.velocity\n'
    same = defined(tmp_path, text)["backlash"]
    assert isinstance(same, OwnEffect)
    with pytest.raises(EffectError, match=r"mine.py:3: backlash: the catalogue has"):
        with_own([same])
    with pytest.raises(EffectError, match="root_drag: there is an effect of this name"):
        with_own([six["root_drag"], six["root_drag"]])


def test_a_prediction_draws_and_takes_effects_of_ones_own(
    six: dict[str, OwnEffect], view: View
) -> None:
    spring, nominal = six["cubic_spring"], {"J": 0.2, "Mc": 5.0, "sigma_2": 1.0}
    model = CorrectedModel(
        nominal, effects={"cubic_spring": {"k": 50.0}}, catalogue=with_own([spring])
    )
    fitted = Fitted(model, Spread(("cubic_spring.k",), np.array([[4.0]]), np.inf))
    drawn = predict(fitted, view.recording, "motion", rng=np.random.default_rng(0))
    known = np.isfinite(drawn.torque)
    assert np.max((drawn.high["torque"] - drawn.low["torque"])[known]) > 0.1
    flat = {**nominal, "cubic_spring.k": 50.0}
    file = {
        "parameters": {n: {"value": v, "unit": ""} for n, v in nominal.items()},
        "alpha": 2.0,
        "effects": {"cubic_spring": {"k": 50.0}},
    }
    for given in (flat, file):
        found = lr.simulate(given, view.recording, given="motion", effects=[spring], draws=0)
        assert np.allclose(found.torque[known], drawn.torque[known], rtol=1e-3)
        with pytest.raises(lr.RecordingError, match="effects="):
            lr.simulate(given, view.recording)
    with pytest.raises(lr.RecordingError, match="lacks width"):
        lr.simulate(
            {"speed_resonance.torque": 1.0, "speed_resonance.speed": 0.3},
            view.recording,
            effects=[six["speed_resonance"]],
        )
