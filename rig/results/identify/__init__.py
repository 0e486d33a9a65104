"""Identification of a run or a campaign: result and report."""
