"""Properties are tried without a limit of time: machines are shared, and no test is timed. Where
`CI` is set they are tried with the same examples every time, so that a change is judged by what it
changes; elsewhere with new ones."""

import os
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path

import pytest
from filelock import FileLock
from hypothesis import HealthCheck, settings

settings.register_profile(
    "untimed",
    deadline=None,
    derandomize=bool(os.environ.get("CI")),
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("untimed")


@pytest.fixture(scope="session")
def once(tmp_path_factory) -> Callable[[str, Callable[[Path], object]], Path]:
    """once(name, make): a folder that make(folder) fills, once for all workers of the session."""
    root = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        root = root.parent

    def made(name: str, make: Callable[[Path], object]) -> Path:
        folder, done = root / name, root / f"{name}.made"
        with FileLock(root / f"{name}.lock"):
            if not done.exists():
                folder.mkdir()
                make(folder)
                done.touch()
        return folder

    return made


def command(*arguments: object) -> None:
    """The command in this process, which must succeed, outside of any test."""
    from topobatch.cli.main import main

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["topobatch", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
    assert not ended.value.code


@pytest.fixture(scope="session")
def samples(once) -> Path:
    """A folder with `topobatch-workspace`, in which the sample logs are ingested and merged, and
    what the command said of it. To be copied by who changes it."""

    def make(folder: Path) -> None:
        logs, place = Path(__file__).parents[1] / "sample_logs", folder / "topobatch-workspace"
        with (folder / "said.txt").open("w") as said, redirect_stdout(said):
            command("ingest", logs, "-j", 1, "-w", place)
            command("merge", "--all", "-j", 1, "-w", place)

    return once("samples", make)
