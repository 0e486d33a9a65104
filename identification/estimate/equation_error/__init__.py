"""Equation-error method (M7-M10): start values from torque equations, covariance, noise floor."""
