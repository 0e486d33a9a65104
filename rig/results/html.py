"""Renders a document as one self-contained HTML page."""

from __future__ import annotations

import jinja2

from rig.results.document import Block, Document


def page(document: Document) -> str:
    """Return a document as HTML, from the template. All text is escaped, and an undefined name in
    the template is an error.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rig.results"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["form"] = _form
    return environment.get_template("page.html.j2").render(document=document)


def _form(block: Block) -> str:
    """Return the kind of a block for the template."""
    return type(block).__name__
