"""The bench: configuration, sequences, safety, recorder, command line and reports."""
