"""Results of the commands: from a record to terminal, JSON, HTML and figures."""
