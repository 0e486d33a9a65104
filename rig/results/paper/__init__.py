"""Reproduction of the paper's figures and tables, each beside the paper's statement."""
