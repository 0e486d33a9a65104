"""Parts of the nominal simulated machine: constants, friction, control loops, valve."""
