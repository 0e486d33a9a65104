"""A plant from elsewhere: MuJoCo's joint, friction, motor and tendons, in a drive's loops."""
