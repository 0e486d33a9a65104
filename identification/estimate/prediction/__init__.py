"""Fits friction models to the angle that a simulation predicts, over a horizon or a whole
recording.
"""
