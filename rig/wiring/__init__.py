"""From configuration to devices: connect, guardian, teardown, limits in the drive, checks before a
run.
"""
