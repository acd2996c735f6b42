"""Where the robot is in a finished map, which stays as it is."""
