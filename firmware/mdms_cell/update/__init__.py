"""Firmware that comes over the bus (CiA 302-3), and its trial."""
