"""Parts of the simulated machine that effects build on: constants, friction, loops, valve."""
