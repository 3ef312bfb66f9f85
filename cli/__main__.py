"""`python -m topobatch.cli`, the same as `topobatch`."""

import os
import sys
import warnings

INTERRUPTED = 130
"""Exit code after SIGINT by shell convention: 128 + signal number."""


def start() -> None:
    """Run the command line; Ctrl-C and other signals end it quietly, even while it is still being
    imported."""
    _quiet()
    try:
        from .process import end_by_signals, open_closed_streams

        open_closed_streams()
        end_by_signals()
        from .main import main

        main()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def _quiet() -> None:
    """Keep warnings of libraries, which say nothing to users, off the terminal, also those of
    worker processes; -W and PYTHONWARNINGS of Python show them."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
        os.environ["PYTHONWARNINGS"] = "ignore"


if __name__ == "__main__":
    start()
