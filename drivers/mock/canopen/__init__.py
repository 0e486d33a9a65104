"""The CANopen side of a simulated device: object dictionary, SDO server, process data, node."""
