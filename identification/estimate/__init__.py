"""From recordings to parameters: the pipelines of ``rig identify``."""
