"""Physics that the simulated machine can hide: names and ranges, formulas, and the kernel that
knows them.
"""
