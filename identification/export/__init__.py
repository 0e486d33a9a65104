"""The corrected model: nominal parameters with identified effects, on recordings and as source
code.
"""
