"""The documents against the code and each other: links, equation numbers, names, list of pages."""

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from .names import found

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *DOCS.rglob("*.md")])
_PATH = re.compile(r"`((?:rig|drivers|identification|tests|benchmarks|docs)/[\w/.-]+)`")
_LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
_FENCE = re.compile(r"^ *```.*?^ *```$", re.MULTILINE | re.DOTALL)
_CODE = re.compile(r"`([^`]+)`")
_NUMBER = re.compile(r"\bM(\d+)\b")
_TAG = re.compile(r"\\tag\{M(\d+)\}")
_PACKAGES = ("drivers.", "identification.", "rig.")


def read(page: str) -> str:
    return (DOCS / f"{page}.md").read_text(encoding="utf-8")


def prose(text: str) -> str:
    """The text without fenced blocks."""
    return _FENCE.sub("", text)


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub and MyST make them."""
    headings = re.findall(r"^#+ (.+)$", prose(page.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.replace("`", "").lower()).replace(" ", "-") for h in headings}


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def rows(text: str) -> list[list[str]]:
    """Cells of the table rows, without heads and rules."""
    lines = text.splitlines()
    rules = [i for i, line in enumerate(lines) if line.startswith("|---")]
    skipped = {*rules, *(i - 1 for i in rules)}
    kept = [line for i, line in enumerate(lines) if i not in skipped]
    return [cells(line) for line in kept if line.startswith("|")]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_relative_link_leads_somewhere(page: Path) -> None:
    for target in _LINK.findall(prose(page.read_text(encoding="utf-8"))):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.is_file(), target
        assert not anchor or anchor in anchors(there), target


def test_the_index_lists_every_page() -> None:
    listed = {(DOCS / t.partition("#")[0]).resolve() for t in _LINK.findall(read("index"))}
    assert listed >= {page for page in DOCS.rglob("*.md") if page.name != "index.md"}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_path_that_a_page_names_exists(page: Path) -> None:
    for name in _PATH.findall(prose(page.read_text(encoding="utf-8"))):
        assert (ROOT / name).exists(), name


@pytest.mark.parametrize("page", ["method", "glossary", "architecture"])
def test_no_equation_is_cited_that_does_not_exist(page: str) -> None:
    known = set(_TAG.findall(read("method")))
    assert set(_NUMBER.findall(read(page))) <= known


def spanned(cell: str) -> Iterator[int]:
    """Every number of "M1 to M3, M5"."""
    for first, last in re.findall(r"M(\d+)(?: to M(\d+))?", cell):
        yield from range(int(first), int(last or first) + 1)


def test_every_equation_is_mapped_to_code_that_exists() -> None:
    table = rows(read("method").split("## 15. Where it is in the code", 1)[1])
    mapped = Counter(n for equations, _, _ in table for n in spanned(equations))
    assert mapped == Counter(int(n) for n in _TAG.findall(read("method")))
    for _, _, code in table:
        names = _CODE.findall(code)
        assert names
        for name in names:
            prefix = "" if name.startswith(_PACKAGES) else "identification."
            assert callable(found(prefix + name)), name


def glossary() -> Iterator[tuple[str, list[str]]]:
    """Package that a section states, and the cells of each of its rows."""
    for section in read("glossary").split("\n## ")[1:]:
        stated = re.search(r"^Below `([^`]+)`\.$", section, re.MULTILINE)
        assert stated, section[:40]
        for row in rows(section):
            yield stated[1], row


def test_every_place_of_the_glossary_exists() -> None:
    for package, (_, _, where) in glossary():
        for name in _CODE.findall(where):
            if "/" in name:
                folders = (ROOT, ROOT / package.replace(".", "/"))
                assert any((folder / name).is_file() for folder in folders), name
            else:
                found(name if f"{name}.".startswith(_PACKAGES) else f"{package}.{name}")


def test_the_architecture_lists_the_folders_of_rig() -> None:
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    table = text.partition("The folders of `rig`")[2].partition("A folder of the table")[0]
    listed = re.findall(r"^\| `(\w+)/` \|", table, re.MULTILINE)
    assert sorted(listed) == sorted(path.parent.name for path in ROOT.glob("rig/*/__init__.py"))
    users = {
        path.relative_to(ROOT).parts[:2]
        for path in ROOT.glob("identification/**/*.py")
        if re.search(r"^\s*(?:import|from) matplotlib", path.read_text(), re.MULTILINE)
    }
    assert users == {("identification", "plots")}
