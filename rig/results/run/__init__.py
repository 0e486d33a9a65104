"""The page of a run, what goes on after it, and the dry run before it."""
