"""Subcommands of ``rig``, one module each, imported only when called."""
