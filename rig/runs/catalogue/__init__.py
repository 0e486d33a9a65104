"""Finds runs in folders and returns their content, with an index, so that folders need not be read
again.

The answers depend only on the folders. The index is a cache: with a missing or damaged index, the
answers are equal but take longer.
"""
