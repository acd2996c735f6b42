"""`slam tune`: settings found on training logs, judged on others."""
