"""Bench, sequence, campaign and fault files: YAML to validated records.

Data only, and what ships with the program.
"""
