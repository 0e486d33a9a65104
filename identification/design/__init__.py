"""Design of experiments: the information of a planned excitation, and a better excitation."""
