"""Where a cell stands and what lies over it, in integers: places, angles, outlines."""
