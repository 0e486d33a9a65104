"""Plant in an independent simulator: joint, friction, motor and tendons of MuJoCo, controlled by
the loops of a drive.
"""
