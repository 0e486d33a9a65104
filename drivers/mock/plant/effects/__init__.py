"""Effects that can be injected into the simulated machine: names, ranges, formulas and kernel."""
