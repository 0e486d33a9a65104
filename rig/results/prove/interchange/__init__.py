"""Sealed rigs as plain files: any simulator can write them, and this package diagnoses, opens and
scores them.
"""
