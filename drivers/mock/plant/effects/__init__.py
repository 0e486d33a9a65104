"""Effects beyond the nominal model that can be injected into the simulated machine."""
