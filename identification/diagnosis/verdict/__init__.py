"""The verdict: identified effects with confidence, in sentences, and what was not recorded."""
