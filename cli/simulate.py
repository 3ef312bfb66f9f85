"""`topobatch simulate`: logs of made-up robots, with the truth beside them."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from ..topology.errors import UsageError
from ..topology.wording import counted
from .options import Extra, QuietOption, verb
from .output import counting, progress, say, show


@verb
def simulate(
    out: Annotated[Path, "OUT", "Folder to write; must be new or empty."],
    world: Annotated[
        Literal["maze", "office", "organic", "city", "rows", "tiles"],
        "--world",
        "Rectilinear maze, repetitive office floor, organic ways, city blocks, equal rows of crops "
        "or racks, or tunnels of standard tiles that all such worlds share.",
    ] = "maze",
    runs: Annotated[int, "--runs N", "Runs in the one world.", Extra(min=1, max=10_000)] = 3,
    unrelated: Annotated[
        int, "--unrelated N", "Further runs, each in a world of its own.", Extra(min=0, max=10_000)
    ] = 0,
    overlap: Annotated[
        float,
        "--overlap SHARE",
        "Share of its junctions that a run has in common with the previous one.",
        Extra(min=0.0, max=0.9),
    ] = 0.4,
    junctions: Annotated[
        int,
        "--junctions N",
        "Approximate number of junctions that a run visits.",
        Extra(min=5, max=100_000),
    ] = 50,
    drift: Annotated[
        Literal["none", "low", "mid", "high", "real"], "--drift", "Odometry's error."
    ] = "mid",
    faults: Annotated[
        Literal["none", "mild", "harsh"],
        "--faults",
        "How often junctions are missed, invented, or wrong about a branch.",
    ] = "mild",
    jumps: Annotated[
        int,
        "--jumps N",
        "How often every run's odometry jumps, by 0.5 m and 30°, while the robot drives on.",
        Extra(min=0),
    ] = 0,
    changes: Annotated[
        int,
        "--changes N",
        "Corridors that close or open between runs; topobatch changes finds them.",
        Extra(min=0, max=10_000),
    ] = 0,
    days: Annotated[
        float | None,
        "--days D",
        "Days from the first run to the last; default: two hours from each to the next.",
        Extra(min=0, max=10_000),
    ] = None,
    laser: Annotated[
        bool,
        "--laser",
        "Write a laser's scans instead of junction detections: walls, doors that open and close, "
        "people walking, glass, as --faults says.",
    ] = False,
    detections: Annotated[
        bool, "--detections", "With --laser: write the detections as well."
    ] = False,
    formats: Annotated[
        list[str] | None,
        "--format FORMAT",
        "mcap, bag, db3 or ros2-mcap; given several times, they are dealt out to the runs. "
        "Default: mcap.",
    ] = None,
    seed: Annotated[int, "--seed N", "The same seed writes the same messages.", Extra(min=0)] = 0,
    force: Annotated[
        bool, "--force", "Write into a folder in use; logs of the same runs there are replaced."
    ] = False,
    quiet: QuietOption = False,
) -> None:
    """Write logs of simulated robots, to try things out on.

    With the truth beside them, in truth.json. The robots explore parts of one world that overlap,
    with odometry that drifts and a junction detector that errs, or a laser (--laser).

    \b
      topobatch simulate mazes
      topobatch simulate offices --world office --runs 2 --laser --format bag
      topobatch simulate months --runs 4 --overlap 0.8 --changes 3 --days 60
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())) and not force:
        raise UsageError(f"{out}: is not an empty folder; choose another, or use --force")
    if detections and not laser:
        raise UsageError("--detections is of runs with a laser; give --laser too")
    from ..simulation.scenario import simulate_scenario
    from ..simulation.settings import DRIFTS, LASERS, ScenarioSettings
    from ..simulation.writing import FORMATS, write_scenario

    if unknown := [name for name in formats or () if name not in FORMATS]:
        raise UsageError(f"no format {unknown[0]!r}: choose one of {', '.join(FORMATS)}")
    show(quiet=quiet)
    settings = ScenarioSettings(
        world=world,
        runs=runs,
        unrelated_runs=unrelated,
        overlap=overlap,
        junctions_per_run=junctions,
        drift=replace(DRIFTS[drift], jumps=jumps),
        faults=faults,
        laser=LASERS[faults] if laser else None,
        tells_junctions=detections or not laser,
        changes=changes,
        days=days,
        seed=seed,
    )
    scenario = simulate_scenario(settings)
    with progress("writing", runs + unrelated, "logs") as advance:
        one_more = counting(advance)
        logs = write_scenario(scenario, out, formats or ["mcap"], lambda _: one_more(1))
    following = shlex.join(("topobatch", "ingest", str(out)))
    say(f"{counted(len(logs), 'log')} and truth.json in {out}; next: {following}")
