"""Figures on their way into a report: rendered once, written to a folder, embedded in the page."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from identification.plots.style import Figure, png


@dataclass(frozen=True)
class Picture:
    """A rendered figure.

    Attributes:
        name: File name without its ending.
        caption: What it shows.
        data: PNG.
    """

    name: str
    caption: str
    data: bytes

    @classmethod
    def of(cls, name: str, caption: str, figure: Figure) -> Picture:
        """Render a figure; characters that do not belong in a file name become underscores."""
        return cls(re.sub(r"[^A-Za-z0-9.-]+", "_", name).strip("_"), caption, png(figure))

    @property
    def base64(self) -> str:
        """The PNG for a data URI."""
        return base64.b64encode(self.data).decode("ascii")


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
