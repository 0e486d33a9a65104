"""Estimation of parameters from recordings: the pipelines of ``rig identify``."""
