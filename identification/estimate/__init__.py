"""Estimates model parameters from recordings: the methods of ``rig identify``."""
