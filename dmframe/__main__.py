"""``python -m dmframe`` is the command ``dmframe``."""

from dmframe.cli import main

main()
