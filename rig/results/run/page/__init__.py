"""The page of a run: its recordings, reduced and plotted.

``traces`` reads a recording, ``channels`` derives what is drawn, ``envelope`` reduces it,
``limits`` and ``phases`` say what held when, ``moment`` when it ended, ``panels`` puts these
together, and ``chart`` draws. The page itself is :mod:`rig.results.run.report`.
"""
