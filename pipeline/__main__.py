"""``python -m pipeline`` is ``puddle``."""

from pipeline.cli import main

main()
