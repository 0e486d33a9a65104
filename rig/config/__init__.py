"""Reads and validates bench, sequence, campaign and fault files (YAML) into records.

The records contain data only. The folder also contains the packaged example files.
"""
