"""A diagnosis with effects of one's own."""

import numpy as np

from identification.diagnosis.diagnose import diagnose, observable_effects
from identification.diagnosis.result import Verdict
from identification.effects.own import OwnEffect, effect
from identification.recording import Dataset, Model, Recording

from .benches import FEW, campaign, with_torque


def short() -> tuple[Recording, ...]:
    return campaign({}, 1, 5.0, FEW)


@effect(k=("N m/rad^3", 0.0, 500.0))
def cubic_spring(s, p):  # type: ignore[no-untyped-def]
    """Spring that stiffens with the angle."""
    return p.k * s.angle**3


class Copy(OwnEffect):
    """The drag of the catalogue."""

    parameters = {"c": ("N m s^2/rad^2", 0.0, 9.0)}  # type: ignore[assignment] # noqa: RUF012

    @staticmethod
    def torque(s, p):  # type: ignore[no-untyped-def]
        return p.c * s.velocity * np.abs(s.velocity)


def test_an_effect_of_ones_own_is_identified_beside_the_catalogue() -> None:
    hidden = Dataset(with_torque(short(), lambda angle, _w, _t: 60.0 * angle**3), Model())
    found = diagnose(hidden, effects=[cubic_spring])
    assert found.verdict is Verdict.NAMED
    (named,) = found.effects
    assert named.name == "cubic_spring"
    k = named.parameters["k"]
    assert k.low <= 60.0 * 1.02
    assert k.high >= 60.0 / 1.02
    assert k.unit == "N m/rad^3"
    assert "spring that stiffens" in named.statement.lower()
    assert named.rivals
    assert found.fit.validate_final_rms is not None
    assert found.fit.validate_baseline_rms is not None
    assert found.fit.validate_final_rms < 0.5 * found.fit.validate_baseline_rms


def test_observability_has_effects_of_ones_own() -> None:
    found = {e.name: e for e in observable_effects(Dataset(short(), Model()), None, [Copy])}
    assert found["copy"].alike["quadratic_drag"] > 0.999
    assert found["quadratic_drag"].alike["copy"] > 0.999
