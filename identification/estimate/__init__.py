"""Estimators: the staged genetic algorithm of the paper, the default method, and their uncertainty."""
