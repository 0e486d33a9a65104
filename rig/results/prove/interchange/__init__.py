"""Sealed rigs as plain files: written by anybody's simulator, diagnosed, opened and scored here."""
