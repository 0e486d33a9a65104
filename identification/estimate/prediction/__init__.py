"""Friction fitted to the predicted angle: simulation over a horizon, up to the whole loop."""
