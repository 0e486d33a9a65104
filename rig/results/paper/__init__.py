"""The paper's figures done again, each with what the paper shows, what came out, and the numbers
drawn.
"""
