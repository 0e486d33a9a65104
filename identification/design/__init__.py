"""Designs experiments: what a planned one determines, and which one separates hypotheses best."""
