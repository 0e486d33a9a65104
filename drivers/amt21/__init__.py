"""The AMT21 encoder over RS-485."""
