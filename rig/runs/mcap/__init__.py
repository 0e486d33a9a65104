"""File format of a recording: MCAP channels that are written during a run, and read back."""
