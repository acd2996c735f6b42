"""Maps drawn from a finished graph: the occupancy grid and its files."""
