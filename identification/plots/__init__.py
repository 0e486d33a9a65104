"""Figures of recordings and fits.

The only place that knows matplotlib; every function returns a ``Figure``.
"""
