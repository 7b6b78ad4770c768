"""`python -m millcal`."""

from millcal.cli import main

main()
