"""The corrected model in plain numpy: nominal friction and every effect of the catalogue, as
functions of signals.

What is here is exported as source, so it imports nothing but numpy. A function of an effect takes
the signals ``s`` of one recording, the nominal model and bench constants ``m``, and the effect's
parameters by the catalogue's names:

torque        what the motion asks of the drive, N m at the joint: J domega/dt + friction + loads
drive         what the logged current gives, N m at the joint
transmission  motor_angle / i - angle, rad
voltage       what the logged current asks of the supply, V

Each returns what it adds to the nominal value.
"""
