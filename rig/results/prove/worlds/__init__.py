"""Draws worlds: machine, drive, encoders, logger and motions of a trial, for any plant."""
