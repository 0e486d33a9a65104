"""Preprocessing of recordings for a diagnosis: marks of motion, signals at one bandwidth, the
nominal model on them.
"""
