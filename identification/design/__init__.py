"""Designs experiments: computes the information of a planned excitation, and searches for a better
excitation.
"""
