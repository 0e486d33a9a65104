"""Equation-error method (M7-M10): start values from torque equations, their covariance, noise
floor.
"""
