"""The SDO server of a cell (CiA 301, 7.2.4)."""
