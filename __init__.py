"""Recorded robot runs to topological maps, and maps of many runs merged.

    import topobatch

    maps = [m for log in logs for m in topobatch.ingest(log)]
    result = topobatch.merge(maps)
    graph = topobatch.to_networkx(result)

All names are described in docs/library.md and by their docstrings. Importing the package does
nothing but define names; they are loaded when they are used, and the heavy libraries (rerun,
rosbags, scipy.optimize) by the functions that need them.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from collections.abc import Callable
    from inspect import Signature

    from .cli.library import (
        changes,
        draw,
        explain,
        export,
        ingest,
        merge,
        next_drives,
        read_map,
        site_map,
        to_dataframe,
        to_networkx,
    )
    from .cli.workspace import Workspace

__all__ = [
    "Workspace",
    "changes",
    "draw",
    "explain",
    "export",
    "ingest",
    "merge",
    "next_drives",
    "read_map",
    "site_map",
    "to_dataframe",
    "to_networkx",
]

_ALSO_FOLDERS = ("ingest", "merge")


def __getattr__(name: str) -> Any:
    if name in _ALSO_FOLDERS:
        from importlib import import_module

        return import_module(f"{__name__}.{name}")  # callable: see _Package
    if name == "__version__":
        from .cli.version import VERSION

        return VERSION
    if name in __all__:
        from .cli import library

        return getattr(library, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _CallableFolder(ModuleType):
    # `topobatch.ingest` and `topobatch.merge` are folders of modules, and the functions of
    # `cli.library` that are called like them: `help` shows those.

    def __call__(self, *args: Any, **options: Any) -> Any:
        """Call the function that is called like the folder (`topobatch.cli.library`)."""
        return self._function()(*args, **options)

    @property
    def __signature__(self) -> Signature:
        from inspect import signature

        return signature(self._function())

    @property
    def __doc__(self) -> str:  # type: ignore[override]
        from inspect import getdoc

        return f"{getdoc(self._function())}\n\nThe folder: {vars(self)['__doc__']}"

    def _function(self) -> Callable[..., Any]:
        from .cli import library

        return cast("Callable[..., Any]", getattr(library, self.__name__.rpartition(".")[2]))


class _Package(ModuleType):
    """Python sets a folder as an attribute of the package whenever something of it is imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _ALSO_FOLDERS and isinstance(value, ModuleType):
            value.__class__ = _CallableFolder
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
