"""Figures: units on the axes, few points, equal figures are equal bytes."""

import io
import re
from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.figure import Figure

from identification.diagnosis.result import ResidualTrace
from identification.plots import fit as fit_plots
from identification.plots import mismatch, signals
from identification.plots.style import COMPRESSION, MAX_POINTS, arrange, continuing, png
from identification.recording import Bench, Recording
from identification.result import (
    Convergence,
    Fit,
    Identification,
    Parameter,
    Profile,
    Starts,
    Trace,
)

UNIT = re.compile(r"\((deg|rad/s|N m|N|m/s|mm|s|%|1|kg|A)\)$")


PROFILE = Profile(
    "Mc", "N m", np.array([6.8, 7.0, 7.4]), np.array([4.0, 0.0, 2.0]), 6.85, None, 1.0
)


def trace(
    name: str = "run", samples: int = 20_001, motion: str = "rotary"
) -> tuple[Trace, Recording]:
    time = np.linspace(0.0, 10.0, samples)
    velocity = 0.4 * np.cos(time)
    torque = np.sign(velocity) * 8.0 + np.random.default_rng(0).normal(0.0, 0.1, samples)
    model = np.sign(velocity) * 8.0
    used = np.abs(velocity) > 0.01
    angle = 0.4 * np.sin(time)
    made = Trace(name, "fit", "unloaded", time, angle, velocity, torque, model, torque, used)
    channels = {"time": time, "command": angle, "angle": angle, "torque": torque}
    return made, Recording(
        name=name, channels=channels, bench=Bench(motion=motion, moment_arm=0.095)
    )  # type: ignore[arg-type]


def result(method: str = "default", motion: str = "rotary") -> Identification:
    values = {"Mc": 7.0, "Ms": 9.0, "omega_sf": 0.05, "sigma_2": 5.0}
    parameters = {n: Parameter(n, "N m", v, 0.95 * v, 1.1 * v) for n, v in values.items()}
    parameters["J"] = Parameter("J", "kg m^2", None, identifiable=False, reason="too slow")
    stage = Convergence(
        "unloaded",
        "search",
        40,
        3,
        1.0,
        "N m",
        target=0.01,
        reached=False,
        cost_history=np.array([3.0, 2.0, 1.0]),
        parameter_history={"Mc": np.array([1.0, 5.0, 7.0]), "J": np.array([0.0, 0.0, 0.0])},
    )
    return Identification(
        method, motion, 2.0, parameters, Fit("N m", 40.0, 0.1, 0.01), (stage,), traces=(trace()[0],)
    )


def of_one_trace(draw: Callable[..., Figure], motion: str = "rotary") -> Figure:
    return draw(trace()[0], trace(motion=motion)[1], "N m" if motion == "rotary" else "N")


FIGURES: dict[str, Callable[[], Figure]] = {
    "response": lambda: of_one_trace(signals.response),
    "response, linear": lambda: of_one_trace(signals.response, "linear"),
    "residual": lambda: signals.residual(trace()[0], "rotary", "N m"),
    "opening": lambda: fit_plots.result(result(), {"run": 0.0}, [trace()[1]]),
    "stribeck": lambda: fit_plots.stribeck(result(), {"run": 0.0}),
    "convergence": lambda: fit_plots.convergence(result().stages[0]),
    "convergence to the truth": lambda: fit_plots.convergence(result().stages[0], {"Mc": 7.1}),
    "intervals": lambda: fit_plots.intervals([result(), result("paper")], {"Mc": 6.9}),
    "profiles": lambda: fit_plots.profiles([PROFILE], list(result().parameters.values())),
    "sealed": lambda: mismatch.sealed(
        {name: (np.linspace(0.0, 9.0, 20_001), *np.ones((3, 20_001))) for name in "ab"}, "N m"
    ),
    "waterfall": lambda: fit_plots.waterfall(
        [Starts("loaded", "-2 log likelihood", (5.0, 3.0, 3.1), 4.0)]
    ),
    "spread": lambda: fit_plots.spread(
        {"paper": {"Mc": [1.0, 0.0, np.inf]}}, {"Mc": 1.1, "Ms": 0.0}, list(result().parameters)
    ),
}


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_has_units_few_points_and_texts_that_do_not_overlap(name: str) -> None:
    made = FIGURES[name]()
    points = [len(line.get_xdata()) for axis in made.axes for line in axis.lines]
    assert max(points) <= MAX_POINTS
    png(made)
    made.set_dpi(110)
    engine = made.get_layout_engine()
    if engine is not None:
        engine.execute(made)
    boxes = [axis.get_tightbbox(made.canvas.get_renderer()) for axis in made.axes]  # type: ignore[attr-defined]
    for k, (axis, box) in enumerate(zip(made.axes, boxes, strict=True)):
        for part, label in ((axis.xaxis, axis.get_xlabel()), (axis.yaxis, axis.get_ylabel())):
            ticks = part.get_ticklabels()
            texts = [t.get_text().replace("mathdefault", "") for t in ticks]
            named = any(letter.isalpha() for text in texts for letter in text)
            hidden = not any(t.get_visible() for t in ticks)
            assert named or hidden or UNIT.search(label), f"{name}: {label!r}"
        # Labels of an axis that is short for them stand out at its ends.
        assert min(box.x0, box.y0) >= -3.0, axis.get_ylabel()
        assert box.x1 <= made.bbox.width + 3.0, axis.get_ylabel()
        assert box.y1 <= made.bbox.height + 3.0, axis.get_ylabel()
        for other in boxes[:k]:
            across = min(box.x1, other.x1) - max(box.x0, other.x0)
            along = min(box.y1, other.y1) - max(box.y0, other.y0)
            assert min(across, along) < 3.0


@pytest.mark.parametrize("name", ["residual", "profiles"])
def test_a_png_is_what_matplotlib_saves_and_reproducible(name: str) -> None:
    ours, theirs = FIGURES[name](), FIGURES[name]()
    theirs.set_dpi(110)
    if theirs.get_layout_engine() is None:
        arrange(theirs)
    saved = io.BytesIO()
    theirs.savefig(
        saved, format="png", dpi=110, metadata={"Software": None}, pil_kwargs=COMPRESSION
    )
    assert png(ours) == saved.getvalue()
    assert png(ours) == saved.getvalue()


def test_a_gap_in_time_breaks_a_line_of_what_is_left_over() -> None:
    time = np.concatenate([np.arange(0.0, 1.0, 0.01), np.arange(1.5, 2.0, 0.01)])
    one = ResidualTrace("run", "fit", "torque", "N m", time, np.ones(150), np.zeros(150))
    for line in mismatch.trace(one, 0.1).axes[0].lines[:2]:
        assert np.flatnonzero(np.isnan(np.asarray(line.get_ydata(), dtype=float))).tolist() == [100]
    assert continuing(time[:1]).all()


def test_the_fitted_curve_is_the_friction_law() -> None:
    axis = fit_plots.stribeck(result(), {"run": 0.0}).axes[0]
    (fitted,) = [line for line in axis.lines if line.get_label() == "fitted"]
    speed, torque = (np.asarray(d, dtype=float) for d in fitted.get_data())
    w = speed[speed > 0.0]
    assert torque[speed > 0.0] == pytest.approx(7.0 + 2.0 * np.exp(-((w / 0.05) ** 2)) + 5.0 * w)
