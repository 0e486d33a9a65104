"""The verdict: identified effects with their confidence, in sentences, and effects that recordings
cannot show for lack of a channel.
"""
