"""Prediction of recordings with a fitted model."""
