"""Drives with their own CAN frames: a DBC file describes the frames, a map states their meaning."""
