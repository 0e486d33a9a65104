"""Reproduction of the paper's figures: each figure with the paper's statement, our result, and the
plotted data.
"""
