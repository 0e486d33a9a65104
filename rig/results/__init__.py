"""What each command finds: from a record to terminal, JSON, HTML and figures."""
