"""`slam bench pareto`: accuracy against the number of matches, by keyframe rule."""
