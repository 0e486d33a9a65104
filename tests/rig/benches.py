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


def sine(
    name: str = "empty",
    amplitude_deg: float = 5,
    frequency_Hz: float = 2,
    duration_s: float = 0.5,
    weight_kg: float = 0,
    more: str = "",
) -> str:
    """Return a stage of one tone."""
    load = f"loaded, weight_kg: {weight_kg}" if weight_kg else "unloaded"
    tone = f"amplitude_deg: {amplitude_deg}, frequency_Hz: {frequency_Hz}"
    return (
        f"{{name: {name}, stage: {load}, tones: [{{{tone}}}],\n"
        f"     duration_s: {duration_s}{more}}}"
    )


def swing(*values: str | float, more: str = "", **named: float) -> str:
    """Return a stage of one tone, with short ramps."""
    ramps = ", ramp_in_s: 0.1, ramp_out_s: 0.1, settle_s: 0.05"
    return sine(*values, **named, more=ramps + more)  # type: ignore[arg-type]


def stages(*each: str, head: str = "", name: str = "short") -> str:
    """Return a sequence of stages, with further lines of its top level before them."""
    return f"sequence: 1\nname: {name}\n{head}stages:\n" + "".join(f"  - {s}\n" for s in each)
