"""Variants of packaged bench files, and short sequences, for tests."""

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


def swing(
    name: str = "empty",
    amplitude_deg: float = 5,
    frequency_Hz: float = 2,
    duration_s: float = 0.5,
    weight_kg: float = 0,
    more: str = "",
) -> str:
    """Return a stage of one tone, with short ramps."""
    load = f"loaded, weight_kg: {weight_kg}" if weight_kg else "unloaded"
    tone = f"amplitude_deg: {amplitude_deg}, frequency_Hz: {frequency_Hz}"
    return (
        f"{{name: {name}, stage: {load}, tones: [{{{tone}}}], duration_s: {duration_s},\n"
        f"     ramp_in_s: 0.1, ramp_out_s: 0.1, settle_s: 0.05{more}}}"
    )


def stages(*each: str, head: str = "") -> str:
    """Return a sequence of stages, with further lines of its top level before them."""
    return f"sequence: 1\nname: short\n{head}stages:\n" + "".join(f"  - {s}\n" for s in each)
