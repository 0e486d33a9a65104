"""General numerical methods without physical models: least squares, optimisers, compilation."""
