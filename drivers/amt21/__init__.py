"""Encoders of the AMT21 series on an RS-485 line."""
