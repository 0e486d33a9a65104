"""What a diagnosis reads of each recording: marks of motion, signals at one bandwidth, the nominal
model on them.
"""
