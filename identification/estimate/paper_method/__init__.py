"""The identification method of the paper (genetic algorithm), and a comparison of optimisers."""
