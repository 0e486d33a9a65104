"""The nominal physical model: friction law, parameters, valve, gas generator, feed-forward."""
