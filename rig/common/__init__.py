"""What every room may use: errors, tables, files, provenance, samples, locks."""
