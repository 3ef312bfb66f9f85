"""The rules of the house: what may import what, what reaches site-packages, who may print."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
import zipfile
from graphlib import TopologicalSorter
from itertools import takewhile
from pathlib import Path

import pytest

from topobatch.cli.main import COMMANDS

ROOT = Path(__file__).parents[1]
PACKAGES = ("topology", "ingest", "merge", "simulation", "viz", "cli")
MAY_IMPORT = {
    "topology": set(),
    "ingest": {"topology"},
    "merge": {"topology"},
    "simulation": {"topology"},
    "viz": {"topology", "merge"},
    "cli": {"topology", "ingest", "merge", "simulation", "viz"},
}
STANDS_ON: dict[str, set[str]] = {
    "topology/posegraph": set(),
    "topology/matching": set(),
    "topology/closure": {"topology/posegraph", "topology/matching"},
    "ingest/remote": set(),
    "ingest/logs": {"ingest/remote"},
    "ingest/odometry": {"ingest/logs"},
    "ingest/scans": {"ingest/logs"},
    "merge/fusion": set(),
    "merge/paper": set(),
    "merge/robust": {"merge/fusion"},
    "viz/exports": set(),
}
VIZ_MAY_USE_OF_MERGE = {"result", "drive", "change", "decision", "decision_text"}
HEAVY = (
    "rerun",
    "numpy",
    "scipy",
    "rosbags",
    "mcap",
    "networkx",
    "pydantic",
    "matplotlib",
    "rich.progress",
)


def modules(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def module_name(path: Path) -> tuple[str, ...]:
    """A module as parts below the root package; a folder stands for its `__init__`."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return parts[:-1] if parts[-1] == "__init__" else parts


def imported(path: Path) -> list[tuple[str, ...]]:
    """Every module of this project that a file imports, as parts below the root package."""
    here = path.relative_to(ROOT).with_suffix("").parts
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
            assert not any(n.split(".")[0] == "topobatch" for n in names), f"{path}: {names}"
        if not isinstance(node, ast.ImportFrom):
            continue
        if node.level == 0:
            assert (node.module or "").split(".")[0] != "topobatch", f"{path}: absolute import"
            continue
        base = here[: len(here) - node.level]
        module = tuple((node.module or "").split(".")) if node.module else ()
        for alias in node.names:
            part = (*base, *module, alias.name)
            is_module = not module or (ROOT / Path(*part)).with_suffix(".py").exists()
            found.append(part if is_module else part[:-1])
    return found


@pytest.mark.parametrize("package", PACKAGES)
def test_imports_go_one_way(package: str) -> None:
    assert modules(package)
    for path in modules(package):
        for target in imported(path):
            head = target[0]
            assert head in PACKAGES, f"{path} imports the package's face"
            if head != package:
                assert head in MAY_IMPORT[package], f"{path} imports {'.'.join(target)}"
            if package == "viz" and head == "merge":
                assert ".".join(target[1:]) in VIZ_MAY_USE_OF_MERGE, (
                    f"{path} imports {'.'.join(target)}"
                )


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Imports for types alone and those inside functions count as well."""
    graph = {
        module_name(path): set(imported(path)) for package in PACKAGES for path in modules(package)
    }
    assert sum(len(targets & graph.keys()) for targets in graph.values()) > len(graph)
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


def folder_of(module: tuple[str, ...]) -> str:
    """The folder within a package that a module lies in, the package itself if it lies in none."""
    inside = len(module) > 1 and (ROOT / module[0] / module[1]).is_dir()
    return "/".join(module[: 1 + inside])


def test_folders_of_a_package_stand_on_each_other_one_way() -> None:
    """Beside what lies in no folder. The two methods of merging know nothing of each other."""
    folders = {folder_of(module_name(path)) for package in PACKAGES for path in modules(package)}
    assert folders - set(PACKAGES) == STANDS_ON.keys()
    for folder, others in STANDS_ON.items():
        for path in modules(folder):
            used = {folder_of(target) for target in imported(path)}
            inner = {
                name for name in used if "/" in name and name.split("/")[0] == folder.split("/")[0]
            }
            assert inner <= {folder, *others}, f"{path} imports from {inner}"


def test_nothing_is_there_that_only_tests_use() -> None:
    """By vulture's reckoning; benchmarks count as use."""
    done = subprocess.run(
        [sys.executable, "-m", "vulture"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert not done.stderr
    lines = done.stdout.splitlines()
    assert [line for line in lines if not line.startswith("benchmarks")] == []


def named_tests(module: tuple[str, ...]) -> Path:
    return ROOT / "tests" / Path(*module[:-1]) / f"test_{module[-1]}.py"


def used_by_test(path: Path) -> set[tuple[str, ...]]:
    """Modules of the package that a test imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("topobatch."):
            module = tuple((node.module or "").split(".")[1:])
            found |= {module, *((*module, alias.name) for alias in node.names)}
    return found


def test_tests_mirror_the_folders() -> None:
    """Every module has a test of its name, or one in the mirrored folder that imports it, or is a
    part of such modules of its folder, imported by them, as the commands are of `cli/main.py`."""
    paths = {
        path.relative_to(ROOT).with_suffix("").parts: path
        for package in PACKAGES
        for path in modules(package)
        if not path.name.startswith("__")
    }
    used = {
        module
        for test in (ROOT / "tests").rglob("*.py")
        for module in used_by_test(test)
        if module[:-1] == test.parent.relative_to(ROOT / "tests").parts
    }
    used |= {("cli", home.partition(".")[0]) for home, _ in COMMANDS.values()}
    tested = {module for module in paths if module in used or named_tests(module).exists()}
    front = tested
    while front:
        parts = {
            part
            for module in front
            for part in imported(paths[module])
            if part in paths and part[:-1] == module[:-1]
        }
        front = parts - tested
        tested |= front
    assert sorted("/".join(module) for module in paths.keys() - tested) == []


def is_number(node: ast.expr) -> bool:
    parts = list(ast.walk(node))
    plain = (ast.Tuple, ast.UnaryOp, ast.BinOp, ast.operator, ast.unaryop, ast.expr_context)
    numbers = [part for part in parts if not isinstance(part, plain)]
    return bool(numbers) and all(
        isinstance(part, ast.Constant) and type(part.value) in (int, float) for part in numbers
    )


def unexplained(path: Path) -> list[str]:
    """Numbers in capitals, and of settings, that no text stands beside.

    The text is a docstring below the number, or a comment above or in its line, with no blank line
    between; or the docstring of the settings, if it names the number.
    """
    lines = path.read_text().splitlines()
    tree = ast.parse("\n".join(lines))
    homes = [(tree.body, None)] + [
        (node.body, ast.get_docstring(node) or "")
        for node in tree.body
        if isinstance(node, ast.ClassDef) and node.name.endswith("Settings")
    ]
    found = []
    for node, about in ((node, about) for body, about in homes for node in body):
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        name = ast.unparse(target)
        if isinstance(target, ast.Subscript) or not is_number(node.value):
            continue
        if about is None and not name.isupper():
            continue
        above = list(takewhile(str.strip, reversed(lines[: node.end_lineno])))
        below = list(takewhile(str.strip, lines[node.end_lineno :]))
        told = any("#" in line for line in above) or any('"""' in line for line in below)
        if not told and not re.search(rf"\b{re.escape(name)}\b", about or ""):
            found.append(f"{path.relative_to(ROOT)}:{node.lineno}: {name}")
    return found


def test_every_chosen_number_is_explained() -> None:
    """That is, there is a text; whether it says where the number comes from, a reader must see."""
    paths = [path for package in PACKAGES for path in modules(package)]
    assert [number for path in paths for number in unexplained(path)] == []


def test_the_architecture_names_what_is_there() -> None:
    """Files, and the functions and settings in which it says that decisions live."""
    page = (ROOT / "ARCHITECTURE.md").read_text()
    files = [path for folder in (*PACKAGES, "tests", "benchmarks") for path in modules(folder)]
    named = re.findall(r"`([\w/]+\.py)(?:: (\w+))?`", page)
    assert len(named) > 50
    for name, function in named:
        found = [path for path in files if f"/{path.relative_to(ROOT)}".endswith(f"/{name}")]
        assert found, name
        assert any(f"def {function}(" in path.read_text() for path in found) or not function, name
    code = "\n".join(path.read_text() for path in files)
    for settings in set(re.findall(r"`(\w+Settings)\b", page)):
        assert f"class {settings}" in code, settings


@pytest.mark.parametrize("package", [p for p in PACKAGES if p != "cli"])
def test_only_the_command_line_prints_or_exits(package: str) -> None:
    for path in modules(package):
        for node in ast.walk(ast.parse(path.read_text())):
            name = node.func if isinstance(node, ast.Call) else None
            assert not (isinstance(name, ast.Name) and name.id in ("print", "exit")), path
            attribute = ast.unparse(name) if isinstance(name, ast.Attribute) else ""
            assert attribute not in ("sys.exit", "os._exit"), path


def test_the_command_line_shows_everything_in_one_place() -> None:
    """There, what would steer a terminal is escaped."""
    for path in modules("cli"):
        calls = [
            node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)
        ]
        names = {ast.unparse(call.func).rsplit(".", maxsplit=1)[-1] for call in calls}
        shown = names & {"echo", "secho", "print", "write"}
        assert not shown or path.name == "output.py", f"{path}: {shown}"


def test_every_module_is_below_a_declared_package() -> None:
    import tomllib

    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    declared = set(settings["tool"]["setuptools"]["packages"])
    for package in PACKAGES:
        for path in modules(package):
            dotted = ".".join(("topobatch", *path.relative_to(ROOT).parent.parts))
            assert dotted in declared, f"{path} would not be installed"


def locked_versions(name: str) -> dict[str, list[str]]:
    """The versions of every package in a lock file; several where they differ by platform."""
    locked: dict[str, list[str]] = {}
    found = re.findall(r"^([\w.-]+)==([\w.+-]+)", (ROOT / name).read_text(), re.MULTILINE)
    for package, version in found:
        locked.setdefault(package.lower(), []).append(version)
    return locked


def test_what_is_imported_is_declared_and_locked() -> None:
    import tomllib
    from importlib.metadata import packages_distributions

    from packaging.requirements import Requirement

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = [Requirement(text) for text in project["dependencies"]]
    tools = [Requirement(text) for text in project["optional-dependencies"]["dev"]]
    locked, runs = locked_versions("requirements-dev.lock"), locked_versions("requirements.lock")
    # What runs the program is what its tests run on, without their tools.
    assert {name: locked.get(name) for name in runs} == runs
    assert not {"pytest", "mypy", "ruff", "hypothesis"} & set(runs)
    for requirement in needed:
        assert re.sub("[._]", "-", requirement.name.lower()) in runs, requirement
    for requirement in [*needed, *tools]:
        found = locked[re.sub("[._]", "-", requirement.name.lower())]
        assert all(requirement.specifier.contains(version) for version in found), requirement
    extras = [
        Requirement(text)
        for extra, texts in project["optional-dependencies"].items()
        if extra != "dev"
        for text in texts
    ]
    declared = {re.sub("[._]", "-", asked.name.lower()) for asked in [*needed, *extras]}
    origin = packages_distributions()
    for path in [path for package in PACKAGES for path in modules(package)]:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            for name in {name.split(".")[0] for name in names} - sys.stdlib_module_names:
                homes = {re.sub("[._]", "-", home.lower()) for home in origin.get(name, [name])}
                assert homes & declared, f"{path}: {name} is not declared"


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys; sys.argv = ['topobatch', '--help']\n"
        "from topobatch.cli.main import main\n"
        "try: main()\n"
        "except SystemExit as end: assert not end.code, end.code\n"
        f"print([m for m in {HEAVY!r} if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"
    assert "ingest" in done.stdout


def test_importing_the_library_does_not_load_the_viewer() -> None:
    code = (
        "import sys, topobatch, topobatch.topology.document, topobatch.merge.merging\n"
        "import topobatch.ingest.reading, topobatch.ingest.mapping, topobatch.viz\n"
        "heavy = ('rerun', 'rosbags', 'scipy.optimize', 'matplotlib')\n"
        "print([m for m in heavy if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_wheel_holds_topobatch_alone(tmp_path: Path) -> None:
    source = tmp_path / "source"  # building leaves files behind; not in the checkout
    skipped = shutil.ignore_patterns(".*", "build", "*.egg-info", "*workspace*", "__pycache__")
    shutil.copytree(ROOT, source, ignore=skipped)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "wheel", "--no-deps"]
    done = subprocess.run(
        [*pip, "--no-build-isolation", "--quiet", "-w", tmp_path, source],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"topobatch"}
    assert "topobatch/cli/main.py" in names
    assert "topobatch/py.typed" in names
    assert not any(name.startswith(("topobatch/tests", "topobatch/sample_logs")) for name in names)
