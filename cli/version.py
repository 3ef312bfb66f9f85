"""Which topobatch this is."""

from __future__ import annotations

VERSION = "0.3.0"
