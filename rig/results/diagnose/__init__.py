"""Diagnosis of a run or a campaign, its report and the corrected model's files."""
