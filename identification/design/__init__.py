"""Design of experiments: what a planned excitation would pin, and which one would pin more."""
