"""Prediction errors of the nominal model on recordings: segments, Kalman filter, likelihood."""
