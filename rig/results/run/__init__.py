"""The page of a run, advice on how to continue it, and the dry run."""
