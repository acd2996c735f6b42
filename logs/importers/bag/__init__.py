"""ROS recordings: containers, types, inventory, and the choice of what to read."""
