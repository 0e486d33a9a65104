"""Diagnosis of missing physics: locate the mismatch, identify its cause, correct the model.

`search` selects an effect, `held_out` keeps or drops it by recordings set aside, `diagnose`
withdraws it if the corrected model is not better, and `judgement` gives verdict, rivals and
confidence.
"""
