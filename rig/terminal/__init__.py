"""The operator's terminal: screen, prompts, the stop button, output that cannot block."""
