"""Front end: from scans to keyframes, matches and loop candidates."""
