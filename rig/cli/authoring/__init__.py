"""Creates bench, sequence and campaign files for a user, and the JSON Schemas for editors."""
