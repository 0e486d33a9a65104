"""The run folder: its record, its recording, how it is read back, recovered, resumed and
exported.
"""
