"""Acceptance of a finished run: its limits held against what it shows, and the certificate."""
