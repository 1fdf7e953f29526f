"""The PDOs of a cell (CiA 301, 7.2.2)."""
