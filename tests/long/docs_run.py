"""Runs every console block of the documents, the long ones too:
``python -m tests.long.docs_run [PAGE ...]``.

Each document has a folder of its own, in which its blocks run one after the other.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.doc_blocks import PAGES, ROOT, Block, blocks, workplace

RECORDINGS = ROOT.parent / "shared" / "recordings"
_LINES = 12
"""Of the output of a command that failed, what is shown."""


def main() -> int:
    """Run the documents named, or all; return 1 where a block failed."""
    pages = [Path(name).resolve() for name in sys.argv[1:]] or PAGES
    failed = [place for page in pages for place in run_page(page)]
    for place in failed:
        print(f"FAILED {place}")
    return 1 if failed else 0


def run_page(page: Path) -> list[str]:
    """Run the blocks of one document; return the places of those that failed."""
    failed = []
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        workplace(place)
        environment = shim(place)
        for block in blocks(page):
            if block.verb == "file":
                (place / block.rest).write_text(block.text, encoding="utf-8")
            elif block.verb == "run" and not run_block(block, place, environment):
                failed.append(block.place)
                break
    return failed


def run_block(block: Block, folder: Path, environment: dict[str, str]) -> bool:
    """Run one block; return whether each command ended as it should."""
    conditions = block.conditions
    needed = conditions.get("needs")
    if needed is not None and not borrowed(needed, folder):
        print(f"skipped {block.place}: {needed} is not there", flush=True)
        return True
    typed = "".join(f"{line.strip()}\n" for line in conditions.get("type", "").split(";"))
    for command in block.commands:
        started = time.perf_counter()
        done = subprocess.run(
            ["bash", "-c", command],
            cwd=folder,
            env=environment,
            input=typed,
            text=True,
            capture_output=True,
            check=False,
        )
        good = done.returncode == int(conditions.get("status", "0"))
        seconds = time.perf_counter() - started
        print(f"{'ok' if good else 'NOT'} {seconds:6.1f} s  {block.place}: {command}", flush=True)
        if not good:
            print("\n".join((done.stdout + done.stderr).splitlines()[-_LINES:]))
            return False
    return True


def borrowed(name: str, folder: Path) -> bool:
    """Link a shared recording and those beside it into a folder."""
    found = next(RECORDINGS.rglob(name), None) if RECORDINGS.is_dir() else None
    if found is None:
        return False
    for path in found.parent.iterdir():
        if not (folder / path.name).exists():
            (folder / path.name).symlink_to(path)
    return True


def shim(folder: Path) -> dict[str, str]:
    """Put a command ``rig`` of this interpreter and this repository on the path."""
    script = folder / ".bin" / "rig"
    script.parent.mkdir()
    script.write_text(
        f'#!/bin/sh\nPYTHONPATH="{ROOT}" exec "{sys.executable}" -c "from rig.cli.entry import '
        f'main; main()" "$@"\n',
        encoding="utf-8",
    )
    script.chmod(0o755)
    return {**os.environ, "PATH": f"{script.parent}:{os.environ['PATH']}"}


if __name__ == "__main__":
    sys.exit(main())
