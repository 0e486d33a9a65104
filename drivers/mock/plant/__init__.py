"""The simulated machine (motor, gear, friction, load); independent of the model that is fitted to
it.
"""
