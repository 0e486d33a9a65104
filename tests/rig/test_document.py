"""A document on the terminal, as a page, and on the disk."""

import errno
from pathlib import Path

import pytest

from rig.common.errors import InputError
from rig.results import document as files
from rig.results.document import (
    Block,
    Document,
    Items,
    Note,
    Paragraph,
    Picture,
    Section,
    SideBySide,
    Table,
    Verdict,
    page,
    text,
    write_page,
    write_record,
    write_texts,
)

LONG = "word " * 40
EVERY: dict[str, Block] = {
    "table": Table(("name", "value"), (("x", "1 <unit>"),), (1,)),
    "note": Note("a line & more", "warning"),
    "paragraph": Paragraph(LONG.strip(), "At first:"),
    "items": Items((("model.py", "the model"), ("", "a line of its own"))),
    "verdict": Verdict("All is well", "Nothing is left.", "good"),
    "picture": Picture("drawn", "What is drawn", b"\x89PNG"),
    "section": Section("Inside", (Note("within"),)),
    "beside": SideBySide(Section("Left", (Note("here"),)), Section("Right", (Note("there"),))),
}


def shown(*blocks: Block) -> str:
    return text(Document("t", "", (Section("", blocks),)))


def drawn(*blocks: Block) -> str:
    return page(Document("A & B", "below", (), (Section("Heading", blocks, "here"),)))


def test_blocks_on_the_terminal() -> None:
    for kind, expected in {
        "table": "name     value\n----  --------\nx     1 <unit>",
        "note": "warning: a line & more",
        "items": "  model.py: the model\n  a line of its own",
        "verdict": "All is well\nNothing is left.",
        "picture": "",
        "section": "Inside\nwithin",
        "beside": "Left\nhere\nRight\nthere",
    }.items():
        assert shown(EVERY[kind]) == expected


def test_blocks_on_the_page() -> None:
    made = drawn(*EVERY.values())
    assert '<h2 id="here">Heading</h2>' in made
    assert "<h1>A &amp; B</h1>" in made
    for expected in (
        '<td>x</td><td class="number">1 &lt;unit&gt;</td>',
        '<p class="warning">a line &amp; more</p>',
        "<p><strong>At first:</strong> word word",
        "<li><code>model.py</code>: the model</li><li>a line of its own</li>",
        '<section class="verdict good"><p class="headline">All is well</p>',
        'src="data:image/png;base64,iVBORw=="><figcaption>What is drawn',
        "<h3>Inside</h3>\n<p>within</p>",
        "<h3>Right</h3>\n<p>there</p>",
    ):
        assert expected in made


def test_pictures_are_files_beside_the_page_wherever_they_stand(tmp_path: Path) -> None:
    inner = Section("", (Picture("deep", "c", b"d"),))
    blocks = (EVERY["picture"], SideBySide(inner, Section("", ())))
    document = Document("t", "", (), (Section("s", blocks),))
    write_page(document, tmp_path / "new" / "page.html")
    assert (tmp_path / "new/figures/drawn.png").read_bytes() == b"\x89PNG"
    assert (tmp_path / "new/figures/deep.png").read_bytes() == b"d"
    assert (tmp_path / "new/page.html").read_text() == page(document)


def test_a_full_disk_is_said_with_the_places(tmp_path, monkeypatch):
    def full(*arguments: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files, "write_text", full)
    monkeypatch.setattr(files, "write_json", full)
    with pytest.raises(InputError, match=f"^{tmp_path} or x.json: cannot be written: No space"):
        write_record({}, tmp_path / "r.json", Path("x.json"))
    with pytest.raises(InputError, match=f"^{tmp_path}: cannot be written: No space"):
        write_texts({"a.txt": ""}, tmp_path)
    with pytest.raises(InputError, match=f"^{tmp_path}: cannot be written: No space"):
        write_page(Document("t", "", ()), tmp_path / "p.html")
