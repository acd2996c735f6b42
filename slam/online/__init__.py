"""`slam online`: the robot, its devices and everything that happens while it drives."""
