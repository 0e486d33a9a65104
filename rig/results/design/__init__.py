"""Experiments proposed for a bench, and how they are written."""
