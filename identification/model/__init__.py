"""What we believe of the machine: friction and load as terms with named parameters."""
