"""The project's own simulated plant as the machine of worlds."""
