"""The simulated machine (motor, gear, friction, load), independent of the fitted model."""
