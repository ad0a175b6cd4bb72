"""``python -m touchfield`` is the command line."""

from touchfield.cli.main import run

run()
