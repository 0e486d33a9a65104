"""Identification of a run or a campaign, and its report."""
