"""Page of a run: its recordings, reduced and plotted.

``traces`` reads a recording, ``channels`` derives the plotted channels, ``envelope`` reduces them,
``limits`` and ``phases`` return the limits and phases over time and the time of the end,
``panels`` combines these, and ``chart`` draws. :mod:`rig.results.run.report` writes the page.
"""
