"""The command line: ``touchfield``, or ``python -m touchfield``."""

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
