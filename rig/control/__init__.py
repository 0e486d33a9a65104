"""The control loop: phases, cycle, safety, sequencer, operator, session, jogging."""
