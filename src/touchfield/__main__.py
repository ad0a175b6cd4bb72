"""Runs the command line as ``touchfield`` or ``python -m touchfield``. It imports little, so that an
interruption while libraries load ends without a traceback."""

import sys


def main() -> None:
    """Run the command line; who interrupts it before its libraries are there gets one line, too."""
    try:
        from touchfield.cli.main import run
    except KeyboardInterrupt:
        sys.exit("touchfield: interrupted")
    run()


if __name__ == "__main__":
    main()
