"""Joint fit of nominal constants and effects: stacked equations, fit within limits, intervals."""
