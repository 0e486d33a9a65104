"""Numerical methods that know no physics: least squares, searches, compilation."""
