"""Plant from an independent simulator: MuJoCo's joint, friction, motor and tendons, in the loops of
a drive.
"""
