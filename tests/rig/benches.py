"""Variants of packaged bench files for tests."""

from __future__ import annotations

from pathlib import Path

from rig.config.configuration import resolve


def variant(
    folder: Path, *changes: tuple[str, str], source: str = "practical", count: int = -1
) -> Path:
    """Write a packaged bench with texts replaced, ``count`` times; each must be there."""
    text = resolve(source, "benches").read_text()
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, count)
    path = folder / "bench.yaml"
    path.write_text(text)
    return path
