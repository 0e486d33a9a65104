"""The truth that tests write with a format's own library, and its loading through a campaign."""

from pathlib import Path

import numpy as np

from identification.recording import Recording
from rig.sources import load_source

N = 300
TIME = np.arange(N) * 1e-3
ANGLE = 0.5 * np.sin(12.0 * TIME)
CURRENT = 2.0 * np.cos(12.0 * TIME) + 0.25 * np.sign(np.cos(12.0 * TIME))
BENCH = "campaign: 1\nbench: {torque_constant: 0.03, gear_ratio: 100}\n"


def load_file(
    folder: Path, name: str, channels: str, read: str = "{}", more: str = ""
) -> Recording:
    """Load one file through a campaign of one recording."""
    entry = f"recordings:\n  - file: {name}\n    read: {read}\n    channels: {channels}\n{more}"
    (folder / "c.yaml").write_text(BENCH + entry, encoding="utf-8")
    (recording,) = load_source(folder / "c.yaml").recordings
    return recording


def same(found: np.ndarray, truth: np.ndarray) -> None:
    """Compare to the last bit."""
    np.testing.assert_array_equal(found, truth)
