"""CAN ports: python-can adapters, the serial-line protocol slcan, bit timing."""
