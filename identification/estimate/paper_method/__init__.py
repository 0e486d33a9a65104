"""The paper's genetic algorithm, and the comparison of searches on its equation error."""
