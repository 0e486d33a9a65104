"""Numerics on recordings: models, estimators, uncertainty, diagnosis.

Pure functions of arrays and frozen records. This package knows nothing of buses, devices, operators
or files.
"""
