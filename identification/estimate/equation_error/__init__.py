"""Equation error (M7 to M10): start values, their covariance, and the torque noise floor."""
