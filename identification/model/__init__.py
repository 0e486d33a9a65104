"""The nominal model: friction law, parameters, valve, gas generator, feed-forward; no
recordings.
"""
