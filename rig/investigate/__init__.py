"""Chooses, runs and judges the next experiment, until the missing physics is named or no experiment
of the bench can name it.
"""
