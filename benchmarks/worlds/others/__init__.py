"""Plants that packages of others simulate; each package is an extra of the benchmarks alone."""
