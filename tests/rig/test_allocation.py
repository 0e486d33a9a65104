"""Freed memory is kept, so that arrays that come and go are not mapped anew."""

from __future__ import annotations

import subprocess
import sys

import pytest

COUNT_FAULTS = """
import resource
import numpy as np
from rig.common.start_up import keep_freed_memory

if {keep}:
    keep_freed_memory()
pair = np.ones(100_000), np.ones(100_000)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(100):
    pair = pair[0] + 1.0, pair[1] + 1.0
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(keep: bool) -> int:
    found = subprocess.run(
        [sys.executable, "-c", COUNT_FAULTS.format(keep=keep)],
        check=True,
        capture_output=True,
        text=True,
    )
    return int(found.stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="the C library is tuned on Linux alone")
def test_arrays_that_come_and_go_fault_in_no_new_pages() -> None:
    assert faults(keep=True) < 2_000 < faults(keep=False)
