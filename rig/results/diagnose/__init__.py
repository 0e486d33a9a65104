"""Diagnosis of a run or a campaign: result, report, and files of the corrected model."""
