"""Many runs: `slam batch` and `slam tune`."""
