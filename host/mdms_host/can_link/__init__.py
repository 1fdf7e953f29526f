"""The CAN bus as the host uses it: the link to an adapter, SDO transfers, a cell's last frames."""
