"""Predicts recordings with a fitted model."""
