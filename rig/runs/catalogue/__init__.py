"""Finds runs in folders and returns what is in them, with an index that saves reading them again.

The folders decide which runs there are and what is in them. The index is a cache: without it, or
with a damaged one, every answer is the same and takes longer.
"""
