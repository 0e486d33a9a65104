"""What is missing and where: tests for a mismatch, its location, and what recordings can show."""
