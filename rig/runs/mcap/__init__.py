"""The recording's file format: MCAP channels written while a run goes on, and read back."""
