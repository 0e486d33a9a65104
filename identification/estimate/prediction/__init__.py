"""The refinement by prediction errors: filter, searches, instruments, what is known of the result."""
