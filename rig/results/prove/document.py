"""Output of ``rig prove`` as a document: the blind proof."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rig.common.provenance import Provenance
from rig.common.tables import number, percent
from rig.results.document import Document, Note, Section, Table, columns, provenance_section
from rig.results.prove.score import STRONG

_RATES = {
    "top1": f"one effect, strength {STRONG:g} or more: named first",
    "alias_group": f"one effect, strength {STRONG:g} or more: in the alias group",
    "top1_left": f"one effect, remaining strength {STRONG:g} or more: named first",
    "alias_group_left": f"one effect, remaining strength {STRONG:g} or more: in the alias group",
    "top1_all": "one effect, any strength: named first",
    "alias_group_all": "one effect, any strength: in the alias group",
    "both_named": f"two effects, strength {STRONG:g} or more: both named",
    "both_named_left": f"two effects, remaining strength {STRONG:g} or more: both named",
    "both_named_all": "two effects, any strength: both named",
    "false_alarms": "no injected effect: false alarms",
    "outside": "outside the catalogue: reported as such",
    "refused": "could not be diagnosed",
    "worse_than_baseline": "held-out error greater than the nominal model's by more than the noise",
    "intervals": "parameters of effects within their interval",
}
_PLACES = {
    "equation": "in the equation where the effect shows",
    "coordinate": "over the catalogue's coordinate",
    "place": "over this or an equivalent coordinate, or in the effect's recording",
}


def prove_document(result: Mapping[str, Any], provenance: Provenance) -> Document:
    """Return a proof as a document, from the record of its result file."""
    rates = shares("what", result, _RATES)
    places = shares("mismatch located", result["location"], _PLACES)
    reliability = columns(
        result["reliability"],
        (1, 2, 3, 4),
        ("confidence of a name", lambda b: f"{b['from']:.1f} to {b['to']:.1f}"),
        ("mean", lambda b: f"{b['mean_confidence']:.2f}"),
        ("right", lambda b: _share(b["right"])[0]),
        ("share", lambda b: _share(b["right"])[1]),
        ("95 % interval", lambda b: _share(b["right"])[2]),
    )
    wrong = columns(
        result["wrong_names"],
        (2,),
        ("trial", lambda n: str(n["rig"])),
        ("wrong name", lambda n: n["name"]),
        ("confidence", lambda n: f"{n['confidence']:.2f}"),
        ("injected", lambda n: ", ".join(n["injected"]) or "nothing"),
        ("in alias group", lambda n: "yes" if n["right_group"] else "no"),
    )
    refused = columns(
        [r for r in result["rigs"] if r.get("refused")],
        (),
        ("trial", lambda r: str(r["rig"])),
        ("not diagnosed, because", lambda r: r["refused"]),
    )
    confusion = columns(
        result["confusion"].items(),
        (),
        ("injected", lambda row: row[0]),
        ("named first", lambda row: ", ".join(f"{name} {n}" for name, n in row[1].items())),
    )
    axes = columns(
        [(axis, part) for axis, parts in result["by_axis"].items() for part in parts],
        (2, 3, 4, 5),
        ("axis", lambda p: p[0]),
        ("value", lambda p: p[1]["value"]),
        ("verdict right", lambda p: _share(p[1]["right"])[0]),
        ("share", lambda p: _share(p[1]["right"])[1]),
        ("95 % interval", lambda p: _share(p[1]["right"])[2]),
        ("not diagnosed", lambda p: str(p[1]["refused"])),
    )
    rigs = columns(
        result["rigs"],
        (0, 2, 3),
        ("trial", lambda r: str(r["rig"])),
        ("injected", lambda r: ", ".join(r["effects"]) or "-"),
        ("strength", lambda r: number(r["strength"], 3)),
        ("remaining", lambda r: number(r["left"], 3)),
        ("verdict", lambda r: r["verdict"]),
        ("named", lambda r: _named(r["named"]) or "-"),
        ("SHA-256", lambda r: r["sha256"][:12]),
    )
    remarks = Section("", tuple(map(Note, _remarks(result))))
    shown = [table for table in (rates, places, reliability, wrong, refused) if table.rows]
    return Document(
        "The blind proof",
        f"{len(result['rigs'])} rigs, each sealed before its diagnosis",
        (*(Section("", (table,)) for table in shown), remarks),
        (
            remarks,
            Section("Rates", (rates,)),
            Section("Location of the mismatch", (places,)),
            Section("Injected and named effects", (confusion,)),
            Section("Confidence and share of right names", (reliability,)),
            Section("Wrong names, and trials not diagnosed", (wrong, refused)),
            *([Section("By the world's axes", (axes,))] if result["by_axis"] else []),
            Section("Rigs", (rigs,)),
            provenance_section(provenance),
        ),
    )


def _named(effects: Sequence[Mapping[str, Any]]) -> str:
    return ", ".join(f"{e['name']} ({e['confidence']:.2f})" for e in effects)


def shares(title: str, rates: Mapping[str, Any], words: Mapping[str, str]) -> Table:
    """Return the rates of the proof, one row each; rates without trials are left out."""
    rows = tuple((words[key], *_share(rates[key], 1)) for key in words if rates[key]["of"])
    return Table((title, "trials", "share", "95 % interval"), rows, (1, 2, 3))


def _share(found: Mapping[str, Any], digits: int = 0) -> tuple[str, str, str]:
    """Return a rate's hits, share and interval as cells."""
    share, low, high = (f"{100 * found[key]:.{digits}f}" for key in ("share", "low", "high"))
    return f"{found['n']} of {found['of']}", f"{share} %", f"{low} to {high} %"


def _remarks(result: Mapping[str, Any]) -> list[str]:
    """Return remarks on the rates."""
    lines = [
        f"On {result['outside']['named_confidently']} trials outside the catalogue, an effect was "
        f"named with high confidence."
    ]
    if result["probability"]["of"]:
        mean, f1 = result["probability"], result["location_f1"]
        lines.append(
            f"Mean probability given to the injected effect, one effect of strength {STRONG:g} or "
            f"more: {mean['share']:.2f} ({mean['low']:.2f} to {mean['high']:.2f}, {mean['of']} "
            f"trials). F1 of the location: {f1['f1']:.2f} ({f1['low']:.2f} to {f1['high']:.2f})."
        )
    for key, words in (
        ("oracle_fraction", "the decrease with the true effects"),
        ("floor_fraction", "the decrease down to the noise floor"),
    ):
        gain = result[key]
        if gain["median"] is not None:
            lines.append(
                f"The diagnosis decreases the error on recordings set aside by "
                f"{percent(100.0 * gain['median'])} of {words} (median of {gain['of']} trials)."
            )
    if result["absorbed"]:
        lines.append(
            f"Of single effects of strength {STRONG:g} or more, {len(result['absorbed'])} have a "
            f"remaining strength below {STRONG:g} after a new fit of the nominal parameters: "
            f"trials {', '.join(map(str, result['absorbed']))}."
        )
    return lines
