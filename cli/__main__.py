"""`python -m topobatch.cli`, the same as `topobatch`."""

import sys

INTERRUPTED = 130
"""128 and the number of the signal, as shells say it."""


def start() -> None:
    """Run the command line; Ctrl-C ends it quietly, even while it is still being imported."""
    try:
        from .main import main

        main()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    start()
