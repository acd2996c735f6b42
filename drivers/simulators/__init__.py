"""Simulators: worlds, a differential-drive robot and a range finder."""
