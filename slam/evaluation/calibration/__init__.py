"""Where the laser sits, what the wheels are worth, and how late they are, from a drive alone."""
