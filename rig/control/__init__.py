"""Runs a plan on a bench: control cycle, limit checks, phases, operator prompts, jogging."""
