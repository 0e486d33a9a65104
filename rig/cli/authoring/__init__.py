"""Files for a user to start from, and the schemas that editors complete and check them with."""
