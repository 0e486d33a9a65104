"""Covariance, Cramer-Rao bound, parameter table with intervals, trade-offs (M37 to M43)."""
