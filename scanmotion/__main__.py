"""The `scanmotion` script, and `python -m scanmotion`: Ctrl-C ends it quietly, also while it still loads."""

import sys


def main() -> None:
    """Runs the command line."""
    try:
        from scanmotion.cli import main as command_line

        command_line()
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
