"""CANopen side of the simulated devices: object dictionary, SDO server, process data, node."""
