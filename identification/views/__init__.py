"""Recordings as signals at the full sample rate on an even grid, and the nominal model as a
function of these signals.
"""
