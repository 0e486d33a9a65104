"""Removes the true constants of a simulated machine from its bench file before it is recorded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from rig.common.yaml_tree import parse

_KNOWN: Mapping[str, frozenset[str] | None] = {
    "motor": frozenset(
        {
            "resistance_ohm",
            "inductance_H",
            "torque_constant_N_m_A",
            "back_emf_constant_V_s_rad",
            "gear_ratio",
        }
    ),
    "joint": frozenset({"moment_arm_m", "lever_ratio", "gravity_m_s2"}),
    "loops": None,
    "sensing": frozenset({"motor_counts_per_turn", "joint_counts_per_turn", "cycle_s"}),
    "steps_per_loop": None,
    "supply_V": None,
}
"""Keys of the ``mock`` section that are kept; None for all keys of a subsection.

Friction, inertia, noise, warming and effects are removed, because they are unknown on a real bench.
"""
# libyaml writes the text faster than PyYAML, but PyYAML may be built without libyaml.
_DUMPER = yaml.CSafeDumper if yaml.__with_libyaml__ else yaml.SafeDumper
_HEAD = (
    "# The true constants of the simulated machine, which are unknown on a real "
    "bench, were removed here.\n"
)


def redacted(content: bytes) -> bytes:
    """Return a valid bench file without the true values of the simulated machine; a file without a
    ``mock`` section is unchanged.
    """
    tree, _ = parse(content.decode("utf-8"))
    bench: Any = tree.plain()
    if not isinstance(bench.get("mock"), dict):
        return content
    bench["mock"] = {
        name: value
        if _KNOWN[name] is None
        else {key: value[key] for key in value if key in (_KNOWN[name] or ())}
        for name, value in bench["mock"].items()
        if name in _KNOWN
    }
    return (_HEAD + yaml.dump(bench, Dumper=_DUMPER, sort_keys=False)).encode("utf-8")
