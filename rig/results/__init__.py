"""Output of the commands: makes terminal text, JSON, HTML and figures from result records."""
