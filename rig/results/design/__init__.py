"""Proposes experiments for a bench, and writes the proposals."""
