"""Drivers: the robot and its laser, on the wire and simulated."""
