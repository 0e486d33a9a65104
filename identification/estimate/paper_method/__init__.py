"""The paper's genetic algorithm, and the comparison of optimisers on its equation error."""
