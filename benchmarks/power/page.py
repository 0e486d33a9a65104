"""Writes the page and the picture of the power map.

python -m benchmarks.power.page out/power docs
"""

from __future__ import annotations

import json
import math
import textwrap
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import click

from benchmarks.power.axes import AXES, BASE
from benchmarks.power.check import CHECK_FILE
from benchmarks.power.picture import draw, number
from benchmarks.power.sizes import FROM, GRID, PARAMETER, SOFT
from benchmarks.power.table import Key, Machine, Spread, decisive, machines_of, natural, table
from benchmarks.power.words import CHECKED, INTRODUCTION, RULE, WORST
from identification.effects import EFFECTS

PICTURE = "power_map.png"
CLEAR = 2.0
"""Factor between the medians along an axis, from which it decides."""
LADDER = (0.0, 1.0, 3.0, 10.0, 30.0, 100.0, math.inf)
"""Edges of the ratio of a size to the least visible one."""
CLEARLY = 10.0
"""Ratio of a size to the least visible one, from which a diagnosis is expected to name it."""
TEN = 10
HEADS = {
    "rate": "Rate of the log",
    "bits": "Resolution of the joint's encoder",
    "encoders": "Encoders",
    "loads": "Loads",
    "excitation": "Excitation",
    "voltage": "Voltage channel",
}
Cells = dict[Key, Spread]


def page(machines: Sequence[Machine], check: Sequence[dict[str, Any]]) -> str:
    """Return the page."""
    cells = table(machines)
    parts = [
        INTRODUCTION.format(machines=len(machines), draws=_draws(machines), picture=PICTURE),
        "## What decides, effect by effect\n",
        *(_item(sentence(machines, effect, cells[effect])) for effect in PARAMETER),
        "",
        WORST,
        _worst(cells),
        "\n## Base world\n",
        _base(machines, cells),
        *(text for axis in AXES for text in (f"\n## {HEADS[axis]}\n", _axis(axis, cells))),
    ]
    if check:
        parts[1:1] = ["## Is what the map calls visible named?\n", checked(check)]
    return "\n".join(parts) + "\n"


def sentence(machines: Sequence[Machine], effect: str, cells: Cells) -> str:
    """Return in words from which size an effect is shown, and which axis changes it most."""
    base = cells[("base", "base")].middle
    seen, _ = natural(machines, effect)
    hidden = {a: [v for v in vs if not _shown(cells[(a, v)])] for a, vs in AXES.items()}
    shown = [_at(a, v) for a, vs in AXES.items() for v in vs if v not in hidden[a]]
    words = f"`{effect}` is "
    if seen is None or not math.isfinite(base):
        words += "not shown in the base world"
        return words + (f", but shown {' or '.join(shown)}." if shown else ".")
    size = f"{seen.middle:.2g} {_unit(effect)}".strip()
    words += f"shown {'up to' if effect in SOFT else 'from'} `{PARAMETER[effect]}` = {size}"
    words += f" ({number(100.0 * base)} % of the injected size)"
    never = [_at(a, v) for a, vs in hidden.items() for v in vs]
    if never:
        words += f", but not {', '.join(never[:-1])}{' or ' if never[:-1] else ''}{never[-1]}"
    axis, factor = decisive(cells)
    if factor < CLEAR:
        other = "other " if never else ""
        return f"{words}. No {other}axis changes the least size of `{effect}` by a factor of 2."
    kept = sorted(
        (v for v in AXES[axis] if v not in hidden[axis]), key=lambda v: cells[(axis, v)].middle
    )
    best, worst = kept[0], kept[-1]
    times = f"{factor:.2g}" if factor < 99.5 else f"{factor:.0f}"
    name = WORDS[axis][0].upper() + WORDS[axis][1:]
    words += f". {name} changes the least size of `{effect}` most: {_at(axis, worst)} it is"
    return f"{words} {times} times as great as {_at(axis, best)}."


WORDS = {
    "rate": "the rate of the log",
    "bits": "the resolution of the joint's encoder",
    "encoders": "the choice of encoders",
    "loads": "the load",
    "excitation": "the excitation",
    "voltage": "the voltage channel",
}


def _at(axis: str, value: str) -> str:
    """Return a value of an axis in words."""
    if axis == "encoders":
        return "with both encoders" if value == "both" else f"with the {value}'s encoder alone"
    if axis == "voltage":
        return {"absent": "without voltage"}.get(value, f"with {value} voltage")
    if axis == "loads":
        return {"none": "without load", "on the joint": "with a weight on the joint"}.get(
            value, f"with {value} on the lever"
        )
    words = {"mixed": "mixed motion", "random": "random motion", "sine": "one sine"}
    return {"rate": f"at {value}", "bits": f"at {value}"}.get(
        axis, f"with {words.get(value, value)}"
    )


def _shown(found: Spread) -> bool:
    return math.isfinite(found.middle)


def _unit(effect: str) -> str:
    name = PARAMETER[effect]
    return next(p.unit for p in EFFECTS[effect].parameters if p.name == name)


def _base(machines: Sequence[Machine], cells: dict[str, Cells]) -> str:
    header = ("effect", "size", "least shown", "injected, middle", "least over injected, %")
    rows = []
    for effect, name in PARAMETER.items():
        seen, given = natural(machines, effect)
        mark = "*" if effect in GRID else ""
        unit = _unit(effect)
        least = "not shown" if seen is None else _quartiles(seen)
        share = _percent(cells[effect][("base", "base")])
        size = f"{name}, {unit}" if unit else name
        if effect in FROM:
            size += f", from {FROM[effect]:g}"
        rows.append((f"`{effect}`{mark}", size, least, f"{given.middle:.3g}", share))
    return _markdown(header, rows)


def _axis(axis: str, cells: dict[str, Cells]) -> str:
    values = AXES[axis]
    header = ("effect", *(f"**{v}**" if BASE[axis] == v else v for v in values))
    rows = [(f"`{e}`", *(_percent(cells[e][(axis, v)]) for v in values)) for e in cells]
    return _markdown(header, rows)


def _quartiles(found: Spread) -> str:
    low, middle, high = (f"{value:.2g}" for value in found)
    return f"{middle} ({low} to {high})"


def _percent(found: Spread) -> str:
    low, middle, high = (number(100.0 * v) if math.isfinite(v) else "\u2013" for v in found)
    return middle if low == middle == high else f"{middle} ({low} to {high})"


def checked(rigs: Sequence[dict[str, Any]]) -> str:
    """Return the tables of predicted and identified effects."""
    parts = [_filled(CHECKED.format(rigs=len(rigs)))]
    for key, words in (("own", "by the rig's own recordings"), ("map", "by the map")):
        rows = []
        for seen in (True, False):
            mine = [r for r in rigs if (r[key] >= 1.0) == seen]
            first = sum(r["first"] for r in mine)
            alias = sum(r["alias"] and not r["first"] for r in mine)
            other = sum(bool(r["named"]) and not r["alias"] for r in mine)
            nothing = sum(r["verdict"] == "nothing_missing" for r in mine)
            rest = len(mine) - first - alias - other - nothing
            label = "visible" if seen else "not visible"
            rows.append((label, *map(str, (len(mine), first, alias, other, nothing, rest))))
        header = (words, "rigs", "named first", "in the alias group", "another named")
        parts.append(_markdown((*header, "nothing missing", "no name, or refused"), rows))
    rows = []
    for low, high in pairwise(LADDER):
        mine = [r for r in rigs if low <= r["own"] < high]
        if mine:
            label = f"{low:g} to {high:g}" if math.isfinite(high) else f"over {low:g}"
            hits = [str(sum(r[k] for r in mine)) for k in ("first", "alias")]
            rows.append((label, str(len(mine)), *hits))
    header = ("size over the least visible", "rigs", "named first", "first or in the alias group")
    parts.append(_markdown(header, rows))
    near = [r for r in rigs if 1.0 <= r["own"] < CLEARLY]
    far = [r for r in rigs if r["own"] >= CLEARLY]
    parts.append(
        _filled(
            RULE.format(
                times=CLEARLY,
                close=f"{sum(_apart(r) <= 3.0 for r in rigs)} of {len(rigs)}",
                worst=f"{max(map(_apart, rigs)):.0f}",
                near=f"{sum(r['first'] for r in near)} of {len(near)}",
                far=f"{sum(r['first'] for r in far)} of {len(far)}",
                alias=f"{sum(r['alias'] for r in far)} of {len(far)}",
            )
        )
    )
    missed = [r for r in rigs if r["own"] >= 1.0 and not r["first"]]
    items = [
        f"`{r['effect']}`, at {r['own']:.3g} times the least size: {_outcome(r)}" for r in missed
    ]
    if items:
        parts.append(
            "These effects are visible by the rig's own recordings, and were not named first:"
        )
        parts.append("\n".join(map(_item, items)))
    return "\n\n".join(parts) + "\n"


def _outcome(rig: dict[str, Any]) -> str:
    """Return the verdict on a rig in words, with the effects that it names."""
    words = f"verdict *{rig['verdict'].replace('_', ' ')}*"
    return words + (f", with {' and '.join(rig['named'])}" if rig["named"] else "")


def _filled(text: str) -> str:
    """Return a paragraph in narrow lines."""
    return textwrap.fill(text, 100, break_long_words=False, break_on_hyphens=False)


def _draws(machines: Sequence[Machine]) -> str:
    """Return the seeds of the machines in words."""
    counts = Counter(m["seed"] for m in machines)
    return ", ".join(f"{n} with seed {seed}" for seed, n in sorted(counts.items()))


def _apart(rig: dict[str, Any]) -> float:
    """Return the factor between the map and the rig's own recordings."""
    if not (rig["own"] and rig["map"]):
        return 1.0 if rig["own"] == rig["map"] else math.inf
    return max(float(rig["own"] / rig["map"]), float(rig["map"] / rig["own"]))


def _item(text: str) -> str:
    """Return an item of a list in narrow lines."""
    return textwrap.fill(
        text,
        98,
        initial_indent="- ",
        subsequent_indent="  ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def _worst(cells: dict[str, Cells]) -> str:
    """Return the effects and axes along which the least size varies most."""
    found = []
    for effect, mine in cells.items():
        for axis, values in AXES.items():
            kept = [v for v in values if _shown(mine[(axis, v)])]
            if len(kept) > 1:
                worst = max(kept, key=lambda v: mine[(axis, v)].middle)
                best = min(kept, key=lambda v: mine[(axis, v)].middle)
                factor = mine[(axis, worst)].middle / mine[(axis, best)].middle
                found.append((factor, effect, axis, best, worst, mine))
    found.sort(key=lambda row: -row[0])
    rows = [
        (
            f"`{effect}`",
            axis,
            f"{worst}: {number(100.0 * mine[(axis, worst)].middle)} %",
            f"{best}: {number(100.0 * mine[(axis, best)].middle)} %",
            f"{factor:.0f}",
        )
        for factor, effect, axis, best, worst, mine in found[:TEN]
    ]
    return _markdown(("effect", "axis", "worst", "best", "factor"), rows)


def _markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


@click.command()
@click.argument("out", type=click.Path(path_type=Path, file_okay=False, exists=True))
@click.argument("docs", type=click.Path(path_type=Path, file_okay=False))
def main(out: Path, docs: Path) -> None:
    """Write DOCS/power.md and its picture from the map in OUT."""
    machines = machines_of(out)
    file = out / CHECK_FILE
    check = json.loads(file.read_text())["rigs"] if file.is_file() else []
    draw(table(machines), len(machines), docs / "images" / PICTURE)
    docs.joinpath("power.md").write_text(page(machines, check))


if __name__ == "__main__":
    main()
