"""``python -m pipeline`` is ``puddle``."""

from pipeline.commands.app import main

main()
