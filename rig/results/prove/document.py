"""Output of ``rig prove`` as a document: the blind proof."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rig.common.provenance import Provenance
from rig.common.tables import number, percent
from rig.results.document import Document, Note, Section, Table, provenance_section
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
    return Document(
        "The blind proof",
        f"{len(result['rigs'])} rigs, each sealed before its diagnosis",
        tuple(_summary(result)),
        tuple(_sections(result, provenance)),
    )


def _summary(result: Mapping[str, Any]) -> Iterator[Section]:
    for cells in (
        _rates(result),
        _places(result),
        _reliability(result),
        _wrong(result),
        _refused(result),
    ):
        if cells.rows:
            yield Section("", (cells,))
    yield Section("", tuple(map(Note, _remarks(result))))


def _sections(result: Mapping[str, Any], provenance: Provenance) -> Iterator[Section]:
    yield Section("", tuple(map(Note, _remarks(result))))
    yield Section("Rates", (_rates(result),))
    yield Section("Location of the mismatch", (_places(result),))
    yield Section("Injected and named effects", (_confusion(result),))
    yield Section("Confidence and share of right names", (_reliability(result),))
    yield Section("Wrong names, and trials not diagnosed", (_wrong(result), _refused(result)))
    if result["by_axis"]:
        yield Section("By the world's axes", (_axes(result),))
    yield Section("Rigs", (_rigs(result),))
    yield provenance_section(provenance)


def shares(title: str, rates: Mapping[str, Any], words: Mapping[str, str]) -> Table:
    """Return the rates of the proof, one row each; rates without trials are left out."""
    rows = tuple((words[key], *_share(rates[key], 1)) for key in words if rates[key]["of"])
    return Table((title, "trials", "share", "95 % interval"), rows, (1, 2, 3))


def _rates(result: Mapping[str, Any]) -> Table:
    return shares("what", result, _RATES)


def _places(result: Mapping[str, Any]) -> Table:
    return shares("mismatch located", result["location"], _PLACES)


def _share(found: Mapping[str, Any], digits: int = 0) -> tuple[str, str, str]:
    """Return a rate's hits, share and interval as cells."""
    share, low, high = (f"{100 * found[key]:.{digits}f}" for key in ("share", "low", "high"))
    return f"{found['n']} of {found['of']}", f"{share} %", f"{low} to {high} %"


def _reliability(result: Mapping[str, Any]) -> Table:
    """Return the share of right names for each band of confidence."""
    rows = tuple(
        (f"{b['from']:.1f} to {b['to']:.1f}", f"{b['mean_confidence']:.2f}", *_share(b["right"]))
        for b in result["reliability"]
    )
    return Table(
        ("confidence of a name", "mean", "right", "share", "95 % interval"), rows, (1, 2, 3, 4)
    )


def _wrong(result: Mapping[str, Any]) -> Table:
    """Return every wrong name."""
    rows = tuple(
        (
            str(n["rig"]),
            n["name"],
            f"{n['confidence']:.2f}",
            ", ".join(n["injected"]) or "nothing",
            "yes" if n["right_group"] else "no",
        )
        for n in result["wrong_names"]
    )
    return Table(("trial", "wrong name", "confidence", "injected", "in alias group"), rows, (2,))


def _refused(result: Mapping[str, Any]) -> Table:
    """Return the trials that could not be diagnosed."""
    rows = tuple((str(r["rig"]), r["refused"]) for r in result["rigs"] if r.get("refused"))
    return Table(("trial", "not diagnosed, because"), rows, ())


def _axes(result: Mapping[str, Any]) -> Table:
    """Return the share of right verdicts for each axis of the world."""
    rows = tuple(
        (axis, part["value"], *_share(part["right"]), str(part["refused"]))
        for axis, parts in result["by_axis"].items()
        for part in parts
    )
    head = ("axis", "value", "verdict right", "share", "95 % interval", "not diagnosed")
    return Table(head, rows, (2, 3, 4, 5))


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


def _confusion(result: Mapping[str, Any]) -> Table:
    rows = tuple(
        (name, ", ".join(f"{given} {times}" for given, times in row.items()))
        for name, row in result["confusion"].items()
    )
    return Table(("injected", "named first"), rows, ())


def _rigs(result: Mapping[str, Any]) -> Table:
    rows = tuple(
        (
            str(row["rig"]),
            ", ".join(row["effects"]) or "-",
            number(row["strength"], 3),
            "-" if row["left"] is None else number(row["left"], 3),
            row["verdict"],
            ", ".join(f"{e['name']} ({e['confidence']:.2f})" for e in row["named"]) or "-",
            row["sha256"][:12],
        )
        for row in result["rigs"]
    )
    return Table(
        ("trial", "injected", "strength", "remaining", "verdict", "named", "SHA-256"),
        rows,
        (0, 2, 3),
    )
