"""Servos whose frames a DBC file describes."""
