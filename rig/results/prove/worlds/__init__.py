"""Worlds: machine, drive, encoders, logger and motions of a trial, all drawn, for any plant."""
