"""Uncertainty of the estimates (M37-M43): covariance, Cramer-Rao bound, intervals, trade-offs."""
