"""Is the weight on the lever what its label says: Coulomb level against mass."""
