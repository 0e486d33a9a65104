"""Sealed rigs as plain files: any simulator can write sealed rigs; this package diagnoses the rigs,
opens their truths and scores the diagnoses.
"""
