"""Finds runs in folders and returns their content, with an index that saves reading the folders
again.

The answers depend only on the folders. The index is a cache: without it, or with a damaged index,
every answer is the same and takes longer.
"""
