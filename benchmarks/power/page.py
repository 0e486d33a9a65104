"""Writes the page and the picture of the power map.

python -m benchmarks.power.page out/power docs
"""

from __future__ import annotations

import json
import math
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
from benchmarks.power.words import CHECKED, INTRODUCTION
from identification.diagnosis.catalogue import ENTRIES

PICTURE = "power_map.png"
CLEAR = 2.0
"""Factor between the medians along an axis, from which it decides."""
LADDER = (0.0, 1.0, 3.0, 10.0, 30.0, 100.0, math.inf)
"""Edges of the ratio of a size to the least visible one."""
Cells = dict[Key, Spread]


def page(machines: Sequence[Machine], check: Sequence[dict[str, Any]]) -> str:
    """Return the page."""
    cells = table(machines)
    parts = [
        INTRODUCTION.format(machines=len(machines), picture=PICTURE),
        "## What decides, effect by effect\n",
        *(f"- {sentence(machines, effect, cells[effect])}" for effect in PARAMETER),
        "\n## Base world\n",
        _base(machines, cells),
        *(text for axis in AXES for text in (f"\n## {axis.capitalize()}\n", _axis(axis, cells))),
    ]
    if check:
        parts[1:1] = ["## Is what the map calls visible named?\n", checked(check)]
    return "\n".join(parts) + "\n"


def sentence(machines: Sequence[Machine], effect: str, cells: Cells) -> str:
    """Return in words from which size an effect is shown, and which axis decides."""
    base = cells[("base", "base")].middle
    seen, _ = natural(machines, effect)
    words = [f"`{effect}`: "]
    if seen is None or not math.isfinite(base):
        words.append("not shown in the base world")
    else:
        more = "down to" if effect in SOFT else "from"
        value = f"{PARAMETER[effect]} {seen.middle:.2g} {_unit(effect)}".strip()
        words.append(f"shown {more} {value}, {number(100.0 * base)} % of the injected size")
    never = [f"{a} {v}" for a, vs in AXES.items() for v in vs if not _shown(cells[(a, v)])]
    axis, factor = decisive(cells)
    if factor < CLEAR:
        words.append("; no axis changes that by a factor of 2")
    elif math.isfinite(factor) or base == math.inf:
        values = [v for v in AXES[axis] if _shown(cells[(axis, v)])]
        best = min(values, key=lambda v: cells[(axis, v)].middle, default="")
        worst = max(values, key=lambda v: cells[(axis, v)].middle, default="")
        if best:
            words.append(_between(axis, cells, best, worst))
    else:
        rest = {a: [cells[(a, v)].middle for v in vs] for a, vs in AXES.items()}
        spans = {
            a: max(kept) / min(kept)
            for a, m in rest.items()
            if len(kept := [x for x in m if math.isfinite(x)]) > 1
        }
        most = max(spans, key=lambda a: spans[a])
        if spans[most] >= CLEAR:
            values = [v for v in AXES[most] if _shown(cells[(most, v)])]
            best = min(values, key=lambda v: cells[(most, v)].middle)
            worst = max(values, key=lambda v: cells[(most, v)].middle)
            words.append(_between(most, cells, best, worst))
    if never and len(never) < sum(map(len, AXES.values())):
        words.append(f"; not shown with {', '.join(_plain(n) for n in never)}")
    return "".join(words) + "."


def _between(axis: str, cells: Cells, best: str, worst: str) -> str:
    low, high = cells[(axis, best)].middle, cells[(axis, worst)].middle
    times = f"{high / low:.2g}" if high / low < 99.5 else f"{high / low:.0f}"
    return f"; the {axis} decides: {times} times as much is needed with {worst} as with {best}"


def _plain(name: str) -> str:
    axis, _, value = name.partition(" ")
    return {
        "encoders": f"the {value} encoder alone",
        "loads": {"none": "no load", "on the joint": "a weight on the joint"}.get(value, value),
        "voltage": f"voltage {value}",
        "rate": value,
        "bits": value,
    }.get(axis, value)


def _shown(found: Spread) -> bool:
    return math.isfinite(found.middle)


def _unit(effect: str) -> str:
    name = PARAMETER[effect]
    return next(p.unit for p in ENTRIES[effect].parameters if p.name == name)


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
    parts = [CHECKED.format(rigs=len(rigs))]
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
    missed = [r for r in rigs if r["own"] >= 1.0 and not r["first"]]
    parts.append("Visible and not named first:\n")
    parts += [
        f"- `{r['effect']}`, {r['own']:.3g} times the least: {r['verdict']}"
        f"{', ' + ', '.join(r['named']) if r['named'] else ''}"
        for r in missed
    ]
    return "\n\n".join(parts[: -len(missed)] if missed else parts) + (
        "\n" + "\n".join(parts[-len(missed) :]) + "\n" if missed else "\n"
    )


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
