"""Worlds: machines, loops, loggers and motions drawn at random, written as sealed folders."""
