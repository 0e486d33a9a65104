"""Figures of recordings and fits.

This is the only package that uses matplotlib. Every function of the package that draws returns a
``Figure``.
"""
