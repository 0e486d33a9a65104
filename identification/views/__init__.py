"""Recordings as signals on an even grid of the full rate; the nominal model of these signals."""
