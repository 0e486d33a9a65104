"""Prediction errors of a model on recordings: motion segments, Kalman filter, noise, likelihood,
breakaway times.
"""
