"""Creation of starting files for a user, and the JSON Schemas for editors."""
