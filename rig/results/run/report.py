"""Writes the page of a run: bench, operator, outcome, advice on how to continue, and recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from html import escape
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

from rig.common.errors import InputError
from rig.common.places import write_text
from rig.results.run.charts import SIMULATED, Plots, last_seconds, result, whole
from rig.results.run.go_on import first_words, go_on_command, go_on_notes, read_verdict
from rig.results.run.recorded import Recorded
from rig.runs.run_record import BENCH_ATTACHMENT, Ending, RunRecord

REPORT_FILE = "run.html"
_BEGIN, _END = "<!--verdict-->", "<!--/verdict-->"
"""Marks around the headline, which is replaced when the run is judged."""
ON_TIME = (
    "Every cycle started on time, because simulated time waits for the program: there is no "
    "lateness to show."
)
STATIC = Path(__file__).parent.parent / "static"
"""Folder of scripts and styles of pages; the console serves them as well."""
UNDRAWN = (
    "The charts are not drawn, because the script of this page did not run. The console runs only "
    "the script of its own version: open the file run.html itself in a browser."
)
SCRIPTS = ("uplot.js", "chart.js", "run.js")


def inlined_script() -> str:
    """Return the script of the page; the console permits it only, by its digest."""
    # Charts are drawn with at least two pixels a point, so that they are sharp on paper.
    sharp = "window.devicePixelRatio = Math.max(2, window.devicePixelRatio);"
    return "\n".join([sharp, *((STATIC / name).read_text("utf-8") for name in SCRIPTS)])


def write_run_report(folder: Path, record: RunRecord) -> Path:
    """Write ``run.html`` into a run folder. A part of the page that cannot be made is replaced by a
    message.

    The page is written without template engine and plotting library, whose import would take longer
    than the rest of a run's end.
    """
    path = folder / REPORT_FILE
    write_text(path, "\n".join(_page(folder, record)) + "\n")
    return path


def write_verdict(folder: Path, record: RunRecord) -> None:
    """Put the verdict of a run that was judged after its end into ``run.html``.

    Only the headline is replaced, because drawing the recordings of an hour takes 20 s.
    """
    path = folder / REPORT_FILE
    page = path.read_text(encoding="utf-8") if path.is_file() else ""
    before, _, rest = page.partition(_BEGIN)
    _, mark, after = rest.partition(_END)
    if mark:
        write_text(path, f"{before}{_verdict_block(folder, record)}{after}")
    else:
        write_run_report(folder, record)


def _page(folder: Path, record: RunRecord) -> Iterator[str]:
    title = escape(f"Run {record.name}")
    yield f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
    yield '<meta name="viewport" content="width=device-width,initial-scale=1">'
    yield '<meta name="color-scheme" content="light dark">'
    style = "".join((STATIC / name).read_text("utf-8") for name in ("uplot.css", "run.css"))
    yield f"<style>{style}</style></head><body><h1>{title}</h1>"
    yield f'<p class="warning" id="undrawn">{UNDRAWN}</p>'
    plots = Plots()
    recordings = [_recorded(folder, record, number) for number in range(1, len(record.parts) + 1)]
    last = recordings[-1] if recordings else None
    yield _verdict_block(folder, record)
    yield from _part("bench, date and operator", lambda: _heading(record, last))
    yield from _part("how it ended", lambda: _ending(folder, record))
    yield '<section class="result">'
    yield from _part("the result", lambda: _drawn(last, plots, result))
    yield "</section>"
    yield '<div class="top"><div>'
    yield from _part("the facts", lambda: [_facts(folder, record)])
    yield "</div><div>"
    header = ("stage", "state", "planned kg", "confirmed kg", "load")
    cells = attrgetter("name", "outcome", "weight_kg", "confirmed_kg", "stage")
    yield from _part("the stages", lambda: _table(header, [cells(s) for s in record.stages]))
    yield "</div></div>"
    for warning in record.warnings:
        yield f'<p class="warning">{escape(warning)}</p>'
    if record.state != Ending.DONE.value:
        yield "<h2>The last seconds</h2>"
        yield from _part("the last seconds", lambda: _drawn(last, plots, last_seconds))
    if record.weights:
        yield "<h2>Weight checks</h2>"
        titles = ("stage", "confirmed kg", "by friction kg", "verdict", "in words")
        of = itemgetter("stage", "confirmed_kg", "measured_kg", "verdict", "message")
        yield from _part("the weight checks", lambda: _table(titles, list(map(of, record.weights))))
    for number, (part, recorded) in enumerate(zip(record.parts, recordings, strict=True), start=1):
        yield f"<h2>Recording {number}: {escape(part.file)}</h2>"
        times = f"begun {_date(part.created)}"
        times += f", ended {_date(part.ended)}" if part.ended else ""
        # The top of the page has the message of the run.
        said = part.message and part.message != record.message
        how = f"{part.state}: {part.message}" if said else part.state
        yield f"<p>{escape(f'{how}; {part.cycles} cycles, {times}')}</p>"
        yield from _part("the traces", partial(_drawn, recorded, plots, whole))
        if part.timing:
            yield from _part("the timing", partial(_timing, part.timing, record))
    yield "<h2>Provenance</h2>"
    yield from _part("the provenance", lambda: _table(("fact", "value"), list(_provenance(record))))
    yield plots.script()
    yield f"<script>{inlined_script()}</script></body></html>"


def _part(what: str, made: Callable[[], Iterable[str]]) -> list[str]:
    """Return one part of the page, or a message: a damaged file must not hide the rest."""
    try:
        return list(made())
    except Exception as error:  # noqa: BLE001 - see above; nothing but the page depends on it
        return [
            f'<p class="warning">This part, {what}, could not be made: '
            f"{escape(f'{type(error).__name__}: {error}')}</p>"
        ]


def _recorded(folder: Path, record: RunRecord, number: int) -> Recorded | str:
    """Read one recording for plotting; return a message if this is impossible."""
    try:
        return Recorded(folder, record, number)
    except InputError as error:
        return error.problems[0]
    except Exception as error:  # noqa: BLE001 - as in _part
        return f"the recording cannot be drawn: {type(error).__name__}: {error}"


def _drawn(
    recorded: Recorded | str | None,
    plots: Plots,
    section: Callable[[Recorded, Plots], Iterable[str]],
) -> Iterable[str]:
    if isinstance(recorded, Recorded):
        return section(recorded, plots)
    return [f'<p class="warning">{escape(recorded or "There is no recording.")}</p>']


def _verdict_block(folder: Path, record: RunRecord) -> str:
    found = "\n".join(_part("the verdict", lambda: _verdict(folder, record)))
    return f"{_BEGIN}{found}{_END}"


def _verdict(folder: Path, record: RunRecord) -> Iterator[str]:
    """Yield the headline of the page: the verdict, or how a run ended that is not judged."""
    found = read_verdict(folder)
    if found is None:
        changed = any(stage.load_change_kg is not None for stage in record.stages)
        kind = "none" if record.state == Ending.DONE.value and not changed else "bad"
        words = f"{record.state}{', load changed' * changed}, not judged".upper()
        yield f'<p class="verdict {kind}">{escape(words)}</p>'
        return
    verdict, failed, pages = found["verdict"], found["failed"], found["pages"]
    kind = "good" if verdict == "accepted" else "bad"
    yield f'<p class="verdict {kind}">{verdict.upper()}</p>'
    links = " and ".join(f'<a href="{page}">{page}</a>' for page in pages)
    words = (
        f"{len(failed)} of {found['checks']} checks failed"
        if failed
        else f"The run is complete and met all {found['checks'] - 1} limits"
    )
    yield f"<p>{words}. Certificate: {links or 'none in this folder'}</p>"
    if failed:
        yield "<ul>" + "".join(f"<li>{escape(words)}</li>" for words in failed) + "</ul>"


def _ending(folder: Path, record: RunRecord) -> Iterator[str]:
    done = record.state == Ending.DONE.value
    yield (
        f'<div class="ending{" done" if done else ""}"><p>How the run ended: '
        f"<b>{escape(record.state)}</b></p>"
    )
    yield f"<p>{escape(record.message) or 'The end of the run was not recorded.'}</p>"
    if not done:
        for words in first_words(record):
            yield f"<p><b>First:</b> {escape(words)}</p>"
        for words in go_on_notes(record):
            yield f"<p>{escape(words[:1].upper() + words[1:])}.</p>"
        command = go_on_command(record, folder)
        if command is not None:
            yield f"<p><b>Go on with:</b> <code>{escape(command)}</code></p>"
    yield "</div>"


def _heading(record: RunRecord, last: Recorded | str | None) -> Iterator[str]:
    """Yield bench, time and operator in one line."""
    bench = last.attached.bench if isinstance(last, Recorded) else None
    file = str(record.inputs.get(BENCH_ATTACHMENT, {}).get("file", "unknown"))
    kind = '<span class="badge real">REAL BENCH</span>'
    if record.simulated:
        kind = '<span class="badge">SIMULATED</span>'
    yield (
        f'<p class="who"><span><i>bench</i> {escape(bench.name if bench else file)} {kind}</span>'
        f"<span><i>begun</i> {escape(_date(record.created))}</span>"
        f"<span><i>operator</i> {escape(record.operators_words)}</span></p>"
    )


def _facts(folder: Path, record: RunRecord) -> str:
    """Return the amount of recorded data and their place."""
    return (
        f"<dl><dt>recorded</dt><dd>{record.cycles} cycles of {1e3 * record.cycle_s:g} ms</dd>"
        f"<dt>run folder</dt><dd>{escape(str(folder.resolve()))}</dd></dl>"
    )


def _date(created: str) -> str:
    return created.replace("T", " ").replace("+00:00", " UTC")


def _timing(timing: Mapping[str, Any], record: RunRecord) -> Iterator[str]:
    keys = ("missed_syncs", "lost_servo", "lost_encoder", "oldest_sample_s")
    header = ("missed SYNCs", "drive samples lost", "encoder samples lost", "oldest sample s")
    yield from _table(header, [tuple(timing[key] for key in keys)])
    simulated = f", {SIMULATED}" if record.simulated else ""
    clock = ", by the clock of this computer" if record.simulated and record.realtime else simulated
    for name, words in (
        ("lateness", "How late cycles started" + clock),
        ("answer", "Age of a sample when the program checks it" + simulated),
    ):
        histogram = timing[name]
        counts, edges = histogram["counts"], [f"up to {edge}" for edge in histogram["edges_us"]]
        most = max([*counts, 1])
        yield f"<h3>{words}: worst {histogram['worst_us']:.0f} us</h3>"
        if name == "lateness" and clock == f", {SIMULATED}" and histogram["worst_us"] == 0.0:
            yield f'<p class="note">{ON_TIME}</p>'
            continue
        yield '<div class="scroll"><table><tr><th>us</th><th>cycles</th><th></th></tr>'
        filled = [k for k, count in enumerate(counts) if count] or [0]
        shown = slice(filled[0], filled[-1] + 1)
        for edge, count in list(zip([*edges, "beyond"], counts, strict=True))[shown]:
            bar = f'<span class="bar" style="width:{10.0 * count / most:.2f}rem"></span>'
            cells = f'<td>{escape(edge)}</td><td class="n">{count}</td><td>{bar}</td>'
            yield f"<tr>{cells}</tr>"
        yield "</table></div>"


def _provenance(record: RunRecord) -> Iterator[tuple[str, str]]:
    for name, entry in record.inputs.items():
        yield f"{name}, SHA-256", entry["sha256"]
    for part in record.parts:
        yield f"{part.file}: operator", part.operator or "not given"
        yield f"{part.file}: seed", str(part.seed)
        versions = ", ".join(f"{name} {value}" for name, value in part.versions.items())
        yield f"{part.file}: versions", versions
        for role in ("servo", "encoder", "pressure"):
            who = part.devices.get(role)
            if who is None:
                continue
            words = f"{who['name']}, serial {who['serial_number']}, revision {who['revision']:08X}h"
            software = who["software_version"] or "not given"
            yield f"{part.file}: {role}", f"{words}, software {software}"
    for item in record.calibrations:
        late = " (OVERDUE)" if item["overdue"] else ""
        yield f"calibration of {item['device']}", f"{item['id']}, due {item['due']}{late}"


def _table(header: tuple[str, ...], rows: list[tuple[Any, ...]]) -> Iterator[str]:
    titles = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    yield f'<div class="scroll"><table><tr>{titles}</tr>'
    for row in rows:
        yield "<tr>" + "".join(map(_cell, row)) + "</tr>"
    yield "</table></div>"


def _cell(value: Any) -> str:
    if value is None:
        return "<td>-</td>"
    if isinstance(value, int | float):
        shown = f"{value:.4g}" if isinstance(value, float) else str(value)
        return f'<td class="n">{shown}</td>'
    return f"<td>{escape(str(value))}</td>"
