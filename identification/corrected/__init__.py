"""The corrected model in plain numpy: nominal friction and every effect of the catalogue, as
functions of signals.

The modules of this package are exported as source code, so they import nothing but numpy. The
function of an effect takes the signals ``s`` of one recording, the nominal parameters and bench
constants ``m``, and the effect's parameters by their catalogue names:

torque        torque that the motion requires, N m at the joint: J domega/dt + friction + loads
drive         drive torque that the logged current produces, N m at the joint
transmission  motor_angle / i - angle, rad
voltage       voltage that the logged current requires, V

Each function returns what its effect adds to the nominal value of one of these quantities.
"""
