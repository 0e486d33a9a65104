"""``rig response`` and ``rig tune``: the excitation, the measured response, proposed gains."""
