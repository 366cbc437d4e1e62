"""`python -m layerfield`."""

from layerfield.cli import main

main()
