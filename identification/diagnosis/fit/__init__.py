"""Joint fit of nominal parameters and effects: stacked equations, fit within limits, intervals."""
