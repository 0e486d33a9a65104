"""Acceptance of a finished run: compares the run with its limits, and writes the certificate."""
