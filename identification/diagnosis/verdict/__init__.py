"""The verdict: identified effects with confidence, in sentences, and effects that need channels not
recorded.
"""
