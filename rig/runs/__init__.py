"""The run folder: its record and recording; reading, recovery, resumption and export."""
