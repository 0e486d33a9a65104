"""The EPOS serial protocol: frames, link, node."""
