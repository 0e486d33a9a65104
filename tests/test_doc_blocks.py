"""Every code block of the documents runs, or says why not; the reference is what the code says."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from rig.cli import entry as cli
from rig.config.bench import load_bench
from rig.config.campaign import load_campaign
from rig.config.faults import load_faults
from rig.config.sequence import load_sequence

from .doc_blocks import PAGES, ROOT, Block, blocks, workplace

BLOCKS = [block for page in PAGES for block in blocks(page)]
RUN = sorted({block.page for block in BLOCKS if block.mark == "run" or block.verb == "file"})
LOADERS = {
    "bench": load_bench,
    "sequence": load_sequence,
    "campaign": load_campaign,
    "faults": load_faults,
}


@pytest.mark.parametrize("block", BLOCKS, ids=lambda b: b.place)
def test_every_block_says_whether_it_is_run(block: Block) -> None:
    assert block.verb in ("file", "run", "not run")
    if block.verb == "not run":
        assert block.rest, "a reason is missing"
    elif block.verb == "run":
        assert block.kind == "console"
        assert block.commands
        assert set(block.conditions) <= {"long", "status", "type", "needs"}
    else:
        assert (block.kind, Path(block.rest).suffix) in {("yaml", ".yaml"), ("python", ".py")}


@pytest.mark.parametrize("page", RUN, ids=lambda p: str(p.relative_to(ROOT)))
def test_its_quick_blocks_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    workplace(tmp_path)
    monkeypatch.chdir(tmp_path)
    for block in blocks(page):
        if block.verb == "file":
            path = tmp_path / block.rest
            path.write_text(block.text, encoding="utf-8")
            if path.suffix == ".yaml":
                LOADERS[next(iter(yaml.safe_load(block.text)))](path)
        elif block.mark == "run":
            for command in block.commands:
                assert run(command) == 0, f"{block.place}: {command}"


def test_the_pages_can_be_walked_in_any_order_in_one_folder() -> None:
    """A page finds no folder that another page wrote, and no file of it with another content."""
    written: dict[str, tuple[Path, str]] = {}
    for block in BLOCKS:
        if block.kind != "console" or block.page.parent.name == "reference":
            continue
        for command in block.commands:
            found = re.search(r"^rig .* --out (\S+)|> (\S+)$", command)
            if found is None:
                continue
            name, content = found[1] or found[2], command if found[2] else ""
            page, before = written.setdefault(name, (block.page, content))
            assert page == block.page or (content and content == before), f"{block.place}: {name}"


def run(command: str) -> int:
    """Run one line; commands of this program in this process, as they start quicker so."""
    words = shlex.split(command)
    if words[0] == "rig":
        return cli.status(words[1:])
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    environment = {**os.environ, "PATH": path}
    return subprocess.run(["bash", "-c", command], env=environment, check=False).returncode


def test_the_reference_is_what_the_code_says() -> None:
    generator = [sys.executable, str(ROOT / "docs" / "generator"), "--check"]
    done = subprocess.run(generator, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
