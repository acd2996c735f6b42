"""Compiles the kernels before anybody waits for them, on two cores where there are two."""
