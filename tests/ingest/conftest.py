"""Shared by the tests of ingest."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


def _beside(name: str) -> ModuleType:
    """A helper module of this folder, which --import-mode=importlib cannot import by name."""
    full = f"topobatch_test_ingest_{name}"
    if full not in sys.modules:
        spec = importlib.util.spec_from_file_location(full, Path(__file__).parent / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        sys.modules[full] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[full])
    return sys.modules[full]


@pytest.fixture(scope="session")
def logs() -> ModuleType:
    """The writers of logs."""
    return _beside("log_writers")


@pytest.fixture(scope="session")
def fuzz() -> ModuleType:
    """The fuzzing harness."""
    return _beside("fuzz_logs")


@pytest.fixture(scope="session")
def sensors() -> ModuleType:
    """Messages of lasers, clouds and grids."""
    return _beside("scan_logs")
