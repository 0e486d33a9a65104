"""Numerics on recordings: models, estimators, uncertainty, diagnosis.

Pure functions of arrays and frozen records. Knows nothing of buses, devices, operators or files.
"""
