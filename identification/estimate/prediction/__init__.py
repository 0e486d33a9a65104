"""Fits friction models by the error of the predicted angle, over a horizon or a whole recording."""
