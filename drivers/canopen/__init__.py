"""CANopen master: link, node, SDO, PDO, EMCY, EDS files, and the profiles CiA 402, 404 and 406."""
