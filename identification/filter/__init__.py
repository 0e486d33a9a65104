"""Recordings and model to prediction errors: motion segments, Kalman filter, noise, likelihood,
breakaway times.
"""
