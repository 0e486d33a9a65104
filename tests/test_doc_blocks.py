"""Every code block of the documents runs, or says why not; the reference is what the code says."""

from __future__ import annotations

import json
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


def run(command: str) -> int:
    """Run one line; commands of this program in this process, as they start quicker so."""
    words = shlex.split(command)
    if words[0] == "rig":
        return cli.status(words[1:])
    return subprocess.run(["bash", "-c", command], check=False).returncode


def test_the_reference_is_what_the_code_says() -> None:
    generator = [sys.executable, str(ROOT / "docs" / "generator"), "--check"]
    done = subprocess.run(generator, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def keys_of(schema: dict[str, object]) -> set[str]:
    """Return the names of all properties in a JSON schema."""
    found: set[str] = set()
    todo: list[object] = [schema]
    while todo:
        item = todo.pop()
        if isinstance(item, dict):
            properties = item.get("properties")
            if isinstance(properties, dict):
                found |= set(properties)
            todo += item.values()
        elif isinstance(item, list):
            todo += item
    return found


@pytest.mark.parametrize("page", ["bench", "sequence", "campaign", "fault_schedule"])
def test_every_key_stands_in_the_reference(page: str) -> None:
    from rig.config.bench import Bench
    from rig.config.campaign import Campaign
    from rig.config.faults import FaultSchedule
    from rig.config.sequence import Sequence

    model = {
        "bench": Bench,
        "sequence": Sequence,
        "campaign": Campaign,
        "fault_schedule": FaultSchedule,
    }[page]
    text = (ROOT / "docs" / "reference" / f"{page}.md").read_text(encoding="utf-8")
    keys = keys_of(model.model_json_schema())
    assert len(keys) > 10
    assert {key for key in keys if f"| `{key}` |" not in text} == set()


def test_every_command_and_option_stands_in_the_reference() -> None:
    import click

    text = (ROOT / "docs" / "reference" / "commands.md").read_text(encoding="utf-8")
    for name in cli.COMMANDS:
        section = text.split(f"## rig {name}\n", 1)[1].split("\n## ", 1)[0]
        command = cli.cli.get_command(click.Context(cli.cli), name)
        assert command is not None
        for parameter in command.params:
            if getattr(parameter, "hidden", False):
                continue
            spelt = (
                parameter.opts
                if isinstance(parameter, click.Option)
                else [parameter.make_metavar(click.Context(command))]
            )
            assert [form for form in spelt if form.strip("[]") not in section] == [], name


@pytest.mark.parametrize(
    "field", ["parameters", "fit_by_recording", "noise_floor_rms", "alias_group", "confirmed_kg"]
)
def test_fields_of_results_stand_in_the_reference(field: str) -> None:
    assert field in (ROOT / "docs" / "reference" / "results.md").read_text(encoding="utf-8")


def test_the_image_of_the_readme_is_small() -> None:
    images = list((ROOT / "docs" / "images").iterdir())
    assert images
    assert max(image.stat().st_size for image in images) < 200_000


def test_the_effects_page_has_every_effect() -> None:
    from identification.effects import EFFECTS

    text = (ROOT / "docs" / "reference" / "effects.md").read_text(encoding="utf-8")
    for name, entry in EFFECTS.items():
        section = text.split(f"### {name}\n", 1)[1].split("\n### ", 1)[0]
        for quantity in entry.parameters:
            assert f"| `{quantity.name}` | {quantity.unit}".rstrip() in section, json.dumps(
                [name, quantity.name]
            )


def test_no_two_steps_of_the_first_pages_share_a_folder() -> None:
    """A reader follows `make demo`, the README and the tutorials in one folder, in any order."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs" / "tutorials").glob("*.md"))]
    written = {"runs/demo": "make demo"}
    for block in (block for page in pages for block in blocks(page) if block.kind == "console"):
        for command in block.text.splitlines():
            words = shlex.split(command.removeprefix("$ "))
            if "--out" in words:
                folder = words[words.index("--out") + 1]
                assert folder not in written, f"{block.place} writes {folder}: {written[folder]}"
                written[folder] = block.place
