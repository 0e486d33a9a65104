"""The page of a run: what was asked, how it ended, how punctual it was. It renders ``run.json``, no more."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import Any

from rig.run_record import RunRecord

REPORT_FILE = "run.html"
_STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:70rem;margin:2rem auto;padding:0 1rem}"
    "h2{font-size:1.2rem;margin-top:2rem;border-bottom:1px solid #ddd}"
    "table{border-collapse:collapse;font-size:.92rem}th,td{padding:.2rem .7rem;border-bottom:1px solid #e4e4e4;"
    "text-align:left;vertical-align:top}th{border-bottom:2px solid #888}"
    "td.n{text-align:right;font-variant-numeric:tabular-nums}"
    ".bar{background:#0072B2;height:.7em;display:inline-block}"
    ".warning{border-left:4px solid #D55E00;padding:.2rem .8rem;background:#fdf3ec}"
)


def write_run_report(folder: Path, record: RunRecord) -> Path:
    """Write ``run.html`` into a run folder.

    Written by hand rather than from a template: loading the template engine would take longer than the rest of the
    ending of a run.

    Raises:
        OSError: It cannot be written.
    """
    path = folder / REPORT_FILE
    path.write_text("\n".join(_page(record)) + "\n", encoding="utf-8")
    return path


def _page(record: RunRecord) -> Iterator[str]:
    title = escape(f"Run {record.name}")
    yield f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
    yield f"<style>{_STYLE}</style></head><body><h1>{title}</h1>"
    yield f"<p><b>{escape(record.state)}</b>: {escape(record.message)}</p>"
    for warning in record.warnings:
        yield f'<p class="warning">{escape(warning)}</p>'
    yield "<h2>Stages</h2>"
    yield from _table(
        ("stage", "load", "planned kg", "confirmed kg", "state"),
        [(s.name, s.stage, s.weight_kg, s.confirmed_kg, s.state) for s in record.stages],
    )
    if record.weights:
        yield "<h2>Weight checks</h2>"
        yield from _table(
            ("stage", "confirmed kg", "by friction kg", "verdict", "in words"),
            [(w["stage"], w["confirmed_kg"], w["measured_kg"], w["verdict"], w["message"]) for w in record.weights],
        )
    for number, part in enumerate(record.parts, start=1):
        yield f"<h2>Recording {number}: {escape(part.file)}</h2>"
        yield f"<p>{escape(part.state)}, {part.cycles} cycles, begun {escape(part.created)}</p>"
        if part.timing:
            yield from _timing(part.timing)
    yield "<h2>Provenance</h2>"
    yield from _table(("fact", "value"), list(_provenance(record)))
    yield "</body></html>"


def _timing(timing: Mapping[str, Any]) -> Iterator[str]:
    yield from _table(
        ("missed SYNCs", "drive samples lost", "encoder samples lost", "oldest sample s"),
        [(timing["missed_syncs"], timing["lost_servo"], timing["lost_encoder"], timing["oldest_sample_s"])],
    )
    for name, words in (("lateness", "How late cycles started"), ("answer", "Age of a sample when it is judged")):
        histogram = timing[name]
        counts, edges = histogram["counts"], [f"up to {edge}" for edge in histogram["edges_us"]]
        most = max([*counts, 1])
        yield f"<h3>{words}: worst {histogram['worst_us']:.0f} us</h3>"
        yield "<table><tr><th>us</th><th>cycles</th><th></th></tr>"
        for edge, count in zip([*edges, "beyond"], counts, strict=True):
            bar = f'<span class="bar" style="width:{20.0 * count / most:.2f}rem"></span>'
            yield f'<tr><td>{edge}</td><td class="n">{count}</td><td>{bar}</td></tr>'
        yield "</table>"


def _provenance(record: RunRecord) -> Iterator[tuple[str, str]]:
    for name, entry in record.inputs.items():
        yield f"{name}, SHA-256", entry["sha256"]
    for part in record.parts:
        yield f"{part.file}: operator", part.operator or "not given"
        yield f"{part.file}: seed", str(part.seed)
        yield f"{part.file}: versions", ", ".join(f"{name} {value}" for name, value in part.versions.items())
        for role in ("servo", "encoder", "pressure"):
            who = part.devices.get(role)
            if who is None:
                continue
            words = f"{who['name']}, serial {who['serial_number']}, revision {who['revision']:08X}h"
            yield f"{part.file}: {role}", f"{words}, software {who['software_version'] or 'not given'}"
    for item in record.calibrations:
        late = " (OVERDUE)" if item["overdue"] else ""
        yield f"calibration of {item['device']}", f"{item['id']}, due {item['due']}{late}"


def _table(header: tuple[str, ...], rows: list[tuple[Any, ...]]) -> Iterator[str]:
    yield "<table><tr>" + "".join(f"<th>{escape(cell)}</th>" for cell in header) + "</tr>"
    for row in rows:
        yield "<tr>" + "".join(_cell(value) for value in row) + "</tr>"
    yield "</table>"


def _cell(value: Any) -> str:
    if value is None:
        return "<td>-</td>"
    if isinstance(value, int | float):
        return f'<td class="n">{value:.4g}</td>' if isinstance(value, float) else f'<td class="n">{value}</td>'
    return f"<td>{escape(str(value))}</td>"
