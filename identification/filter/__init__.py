"""Prediction errors of the nominal model: motion segments, Kalman filter, likelihood."""
