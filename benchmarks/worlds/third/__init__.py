"""A plant written from the paper and the list of effects alone."""
