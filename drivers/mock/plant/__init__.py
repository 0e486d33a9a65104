"""The true machine behind the simulated bus; independent of the model fitted to it."""
