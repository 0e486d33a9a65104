"""Preprocessing of recordings for a diagnosis: marks of motion, signals at one bandwidth, and the
nominal model as a function of these signals.
"""
