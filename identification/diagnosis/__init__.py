"""Diagnosis of missing physics: locate the mismatch, identify its cause, correct the model."""
