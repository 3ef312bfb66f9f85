"""`python -m topobatch.cli`, the same as `topobatch`."""

import sys

INTERRUPTED = 130
"""Exit code after SIGINT by shell convention: 128 + signal number."""


def start() -> None:
    """Run the command line; Ctrl-C and other signals end it quietly, even while it is still being
    imported."""
    try:
        from .process import end_by_signals, open_closed_streams

        open_closed_streams()
        end_by_signals()
        from .main import main

        main()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    start()
