"""The same proof with one process, two, a cluster of two workers, and such a cluster of which a
worker is killed on the way: are the bytes of its files the same?

    python -m tests.long.cluster OUT --rigs 12 --seed 1
    python -m tests.long.cluster OUT --rigs 6
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import click
import psutil

ENGINES = {
    "one process": ("--jobs", "1"),
    "two processes": ("--jobs", "2"),
    "cluster of two": ("--cluster", "2"),
    "cluster of two, a worker killed": ("--cluster", "2"),
}
KILLED = "cluster of two, a worker killed"
TIMED = ("times/", "report.html", "prove.json")
"""Files with dates or durations."""
POLL_S = 0.5
COMMAND = "from rig.cli.entry import main; main()"


def proved(folder: Path, options: Sequence[str], kill: bool) -> tuple[float, float]:
    """Run a proof; return the time on the clock, and that of all its processes, in seconds."""
    folder.mkdir(parents=True)
    began = time.monotonic()
    spent: dict[int, float] = {}
    with subprocess.Popen(
        [sys.executable, "-c", COMMAND, "prove", *options, "--out", "proof"],
        cwd=folder,
        stdout=subprocess.DEVNULL,
    ) as process:
        while process.poll() is None:
            workers = list(_workers(process.pid))
            for worker in (psutil.Process(process.pid), *workers):
                try:
                    spent[worker.pid] = sum(worker.cpu_times()[:2])
                except psutil.NoSuchProcess:
                    continue
            if kill and workers and _done(folder):
                busiest = max(workers, key=lambda w: spent.get(w.pid, 0.0))
                click.echo(f"  killing worker {busiest.pid} after {_done(folder)} trials")
                busiest.kill()
                kill = False
            time.sleep(POLL_S)
    if process.returncode != 0 or kill:
        raise click.ClickException(f"{folder}: ended with {process.returncode}, killed: {not kill}")
    return time.monotonic() - began, sum(spent.values())


def _workers(pid: int) -> Iterator[psutil.Process]:
    for child in psutil.Process(pid).children():
        try:
            words = child.cmdline()
        except psutil.NoSuchProcess:  # it ended a moment ago
            continue
        if "resource_tracker" not in " ".join(words):
            yield child


def _done(folder: Path) -> int:
    return len(list((folder / "proof").glob("judgements/*.json"))) or len(
        list((folder / "proof").glob("rows/*.json"))
    )


def content(out: Path) -> dict[str, bytes]:
    """Return the files of a proof that must repeat."""
    files = {f.relative_to(out).as_posix(): f for f in sorted(out.rglob("*")) if f.is_file()}
    return {name: f.read_bytes() for name, f in files.items() if not name.startswith(TIMED)}


@click.command()
@click.argument("out", type=click.Path(path_type=Path, file_okay=False))
@click.option("--rigs", type=click.IntRange(min=1), default=12, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True)
@click.argument("options", nargs=-1)
def main(out: Path, rigs: int, seed: int, options: Sequence[str]) -> None:
    """Compare proofs in OUT, with further OPTIONS of rig prove after --."""
    shutil.rmtree(out, ignore_errors=True)
    given = ["--rigs", str(rigs), "--seed", str(seed), *options]
    found: dict[str, dict[str, bytes]] = {}
    for name, engine in ENGINES.items():
        folder = out / name.replace(", ", "-").replace(" ", "-")
        clock, processor = proved(folder, [*given, *engine], name == KILLED)
        found[name] = content(folder / "proof")
        size = sum(map(len, found[name].values()))
        click.echo(
            f"{name}: {len(found[name])} files, {size} bytes, {clock:.0f} s, "
            f"processor {processor:.0f} s"
        )
    alone = found["one process"]
    different = [
        f"{name}: {file}"
        for name, files in found.items()
        for file in sorted(files.keys() | alone.keys())
        if files.get(file) != alone.get(file)
    ]
    click.echo("\n".join(different) or f"all {len(alone)} files are the same bytes")
    sys.exit(bool(different))


if __name__ == "__main__":
    main()
