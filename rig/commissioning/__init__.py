"""Commissioning: goes through a new bench with the operator, step by step and at low limits."""
