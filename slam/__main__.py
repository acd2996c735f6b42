"""`python -m slam` is the `slam` command."""

from slam.cli import main

main()
