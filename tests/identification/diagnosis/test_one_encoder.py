"""Effects that the encoder of the motor alone does not distinguish."""

from __future__ import annotations

from dataclasses import replace

import pytest

from identification.diagnosis.fit.joint import Added
from identification.diagnosis.selection.comparison import Contender, Round
from identification.diagnosis.selection.indistinct import with_indistinct_effects
from identification.diagnosis.selection.search import Search
from identification.diagnosis.terms import TERMS

from .benches import honest, nominal_fit

TERM = {t.name: t for t in TERMS}


@pytest.mark.parametrize(
    ("name", "kept", "alias"),
    [
        ("presliding", "motor_angle", ("compliance",)),
        ("presliding", "angle", ()),
        ("asymmetric_coulomb", "motor_angle", ()),
    ],
)
def test_a_spring_in_the_friction_and_a_twisted_shaft_are_alike_to_the_motors_encoder(
    name: str, kept: str, alias: tuple[str, ...]
) -> None:
    dropped = {"motor_angle", "angle"} - {kept}
    recordings = [
        replace(r, channels={k: v for k, v in r.channels.items() if k not in dropped})
        for r in honest()
    ]
    joint = nominal_fit(recordings)
    shape = (5e3,) if name == "presliding" else ()
    final = replace(joint, effects=(Added(TERM[name], shape, (1.0,)),))
    tested = Contender("stribeck_shape", joint, 4.0, "")
    found = Search(joint, final, (Round(name, (tested,)),), 1e-3, 1.0, "", ())
    (taken,) = with_indistinct_effects(found, ()).rounds
    assert tuple(r.name for r in taken.rivals) == ("stribeck_shape", *alias)
    assert all(r.preference == 0.0 for r in taken.rivals if r.name in alias)
