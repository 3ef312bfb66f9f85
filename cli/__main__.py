"""`python -m topobatch.cli`, the same as `topobatch`."""

from .main import main

main()
