"""From configuration to devices: connect, guardian, teardown, limits, checks before a run."""
