"""Proposed experiments for a bench, and their output."""
