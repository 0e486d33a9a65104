"""Sphinx configuration: ``make docs``.

The pages are plain Markdown that a repository browser shows as well: `index.md` has no toctree
directive. Its sections and links make the table of contents here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from sphinx.application import Sphinx

project = "loadrig"
author = "the loadrig authors"
extensions = ["myst_parser", "sphinx.ext.mathjax", "sphinx-mathjax-offline"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["generator"]
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 4
html_theme = "furo"
html_title = "loadrig"
html_static_path = ["static"]
html_css_files = ["tables.css"]
html_theme_options = {
    "light_css_variables": {"content-padding": "2em"},
    "top_of_page_buttons": [],
}
html_show_sphinx = False

_OUTSIDE = re.compile(r"\[([^\]]*)\]\((?:\.\./)+(?:README|CHANGELOG)\.md[^)]*\)")
"""Links to the two pages that lie above this folder."""
_PAGE = re.compile(r"\]\(([\w/-]+)\.md(?:#[\w-]+)?\)")
_CODE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


def contents(index: str) -> Iterator[str]:
    """Yield a hidden toctree for each section of the index, with the pages that it links to."""
    listed: set[str] = set()
    for section in re.split(r"^## ", _CODE.sub("", index), flags=re.MULTILINE)[1:]:
        title, _, body = section.partition("\n")
        pages = [page for page in dict.fromkeys(_PAGE.findall(body)) if page not in listed]
        listed.update(pages)
        if pages:
            yield "\n".join(["```{toctree}", ":hidden:", f":caption: {title}", "", *pages, "```"])


def prepared(app: Sphinx, name: str, content: list[str]) -> None:
    """Take links out of the folder away, and give the index its table of contents."""
    content[0] = _OUTSIDE.sub(r"\1", content[0])
    if name == "index":
        content[0] += "\n\n" + "\n\n".join(contents(content[0])) + "\n"


def setup(app: Sphinx) -> None:
    """Register :func:`prepared`."""
    app.connect("source-read", prepared)
