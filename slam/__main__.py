"""`python -m slam` is the `slam` command."""

from slam.cli.main import main

main()
