"""Pages of the commands that make no document yet."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jinja2

from rig.common.result_files import Provenance
from rig.results.document import Picture, Table


def save(pictures: Iterable[Picture], folder: Path) -> dict[str, str]:
    """Write PNG files into ``folder/figures`` and return name to path relative to ``folder``.

    Raises:
        OSError: The folder cannot be written.
    """
    target = folder / "figures"
    target.mkdir(parents=True, exist_ok=True)
    for picture in pictures:
        (target / f"{picture.name}.png").write_bytes(picture.data)
    return {picture.name: f"figures/{picture.name}.png" for picture in pictures}


def render(template: str, **context: Any) -> str:
    """Fill a packaged template; everything is escaped, and a name the template lacks is an
    error.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rig.results"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    return environment.get_template(template).render(**context)


def provenance_tables(provenance: Provenance) -> dict[str, Table]:
    """Return the tables that end every page."""
    facts = (
        (
            "versions",
            ", ".join(f"{name} {release}" for name, release in provenance.versions.items()),
        ),
        ("created", provenance.created),
        ("seed", str(provenance.seed)),
        ("time spent", f"{provenance.seconds:.3g} s"),
    )
    files = tuple(provenance.inputs.items())
    return {
        "provenance": Table(("fact", "value"), facts, ()),
        "inputs": Table(("input file", "SHA-256"), files, ()),
    }
