"""The array in Python: simulate it, drive it by hand, connect to a real one."""
