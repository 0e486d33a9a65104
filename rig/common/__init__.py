"""Common modules of the bench side: errors, tables, files, provenance, samples, locks."""
