"""The true machine behind the simulated bus, written apart from the model that is fitted to it."""
