"""Simulated drives with the CAN frames of drives without CANopen: ODrive and MIT-style motors."""
