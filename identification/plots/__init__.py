"""Figures of recordings and fits.

The only package that uses matplotlib; every function returns a ``Figure``.
"""
