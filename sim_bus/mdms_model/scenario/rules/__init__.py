"""The rules of a scenario that can be run, table by table."""
