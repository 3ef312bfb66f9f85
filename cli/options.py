"""Options that several commands share, and `settings.toml` of a workspace: options that its
commands take where a call does not give them.

A call's own options come first, then environment variables, then that file, then the defaults.
"""

from __future__ import annotations

import json
import os
import tomllib
from collections import ChainMap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, isfunction, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_origin, get_type_hints

import typer
from typer.exceptions import TyperException

from ..ingest.remote.path import LogPath, log_path
from ..topology.errors import DocumentError, LogError, TopobatchError, UsageError
from ..topology.files import read_bytes
from .output import remember
from .workspace import MERGED, USUAL, Workspace

if TYPE_CHECKING:  # what takes a second to load
    from ..ingest.mapping_settings import MappingSettings
    from ..ingest.reading import ReadSettings

Command = Callable[..., None]


class Extra(dict[str, Any]):
    """Further arguments of `typer.Option` or `typer.Argument`, in the annotation of a parameter."""


def verb(command: Command) -> Command:
    """The command as typer takes it.

    Its parameters are annotated as Annotated[type, "--last -n N", "What it is for."], with the
    names of the option and what its value is called; without a name it is an argument. In place of
    a parameter that is made of several options, a dataclass or annotated with the function that
    makes it, typer is given these. A dataclass's `panel` is their section of `--help`.
    """
    hints = get_type_hints(command, include_extras=True)
    made = {name: _maker(hint) for name, hint in hints.items()}

    @wraps(command)
    def called(**given: Any) -> None:
        for name, maker in made.items():
            if maker is not None:
                options = {own: given.pop(own) for own in signature(maker).parameters}
                given[name] = maker(**options)
        command(**given)

    parameters = []
    for name, own in signature(command).parameters.items():
        maker = made[name]
        several = {name: own} if maker is None else signature(maker).parameters
        kinds = hints if maker is None else get_type_hints(maker, include_extras=True)
        panel = getattr(maker, "panel", None)
        parameters += [
            each.replace(kind=Parameter.KEYWORD_ONLY, annotation=_typed(kinds[own_name], panel))
            for own_name, each in several.items()
        ]
    called.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    called.__annotations__ = {each.name: each.annotation for each in parameters}
    return called


def _maker(hint: Any) -> Callable[..., Any] | None:
    """What makes a parameter of several options; None if it is an option itself."""
    if is_dataclass(hint):
        return hint  # type: ignore[return-value]
    return next(filter(isfunction, getattr(hint, "__metadata__", ())), None)


def _typed(hint: Any, panel: str | None) -> Any:
    """The annotation of a parameter as typer takes it."""
    if get_origin(hint) is not Annotated:
        return hint
    shown, text, *extra = hint.__metadata__
    words = shown.split()
    names = [word for word in words if word.startswith("-")]
    value = " ".join(words[len(names) :]) or None
    kind = typer.Option if names else typer.Argument
    more = dict(ChainMap(*extra), metavar=value, help=text, rich_help_panel=panel)
    return Annotated[hint.__origin__, kind(*names, **more)]


def _with_settings(context: typer.Context, workspace: Path) -> Path:
    """The workspace, with what it remembers as the defaults of the command's other options.
    DocumentError if one of them does not take its value."""
    if context.resilient_parsing:
        return workspace
    place = Workspace(workspace)
    own = {param.name: param for param in context.command.params}
    settings = {name: value for name, value in settings_of(place).items() if name in own}
    for name, value in settings.items():
        try:
            own[name].process_value(context, value)
        except TyperException as error:
            why = f"{option_name(name)}: {error.format_message()}"
            raise DocumentError(f"{place.settings_toml}: {why}") from error
    context.default_map = settings
    remember(place.settings_toml, lambda: map(flag, taken(context, REMEMBERED)))
    return workspace


GIVEN, REMEMBERED = ("COMMANDLINE", "ENVIRONMENT"), ("DEFAULT_MAP",)
"""Where options come from: the call, and settings.toml."""


def taken(context: typer.Context, sources: Sequence[str]) -> dict[str, Any]:
    """The options that a workspace may remember, as far as a command took them from there."""
    found = ((name, context.get_parameter_source(name)) for name in NAMES)
    return {name: context.params[name] for name, at in found if at and at.name in sources}


WorkspaceOption = Annotated[
    Path,
    "--workspace -w",
    "Folder of the results.",
    Extra(envvar="TOPOBATCH_WORKSPACE", file_okay=False, is_eager=True, callback=_with_settings),
]

MergeOption = Annotated[str, "--merge NAME", "The merge to use, by its --output NAME."]


def _place(workspace: WorkspaceOption = USUAL) -> Workspace:
    return Workspace(workspace)


def _place_of_merge(workspace: WorkspaceOption = USUAL, merge: MergeOption = MERGED) -> Workspace:
    return Workspace(workspace, merge)


Here = Annotated[Workspace, _place]
HereWithMerge = Annotated[Workspace, _place_of_merge]
"""The workspace that a command is about, with one of its merges."""

QuietOption = Annotated[bool, "--quiet -q", "Show errors only: no progress, no summary."]

SiteOption = Annotated[
    str | None, "--site NAME", "Only this site of the merged map (topobatch list)."
]

ComponentOption = Annotated[
    int | None, "--component N", "Only this component, by its number.", Extra(min=0, hidden=True)
]
"""How scripts named a site before sites had names."""

FalseMergeRate = Annotated[
    float | None,
    "--false-merge-rate SHARE",
    "Share of batches that may hold any false merge; default 0.001.",
    Extra(min=1e-9, max=0.5),
]

JsonOption = Annotated[bool, "--json", "Print JSON."]

ThemeOption = Annotated[Literal["light", "dark"], "--theme", "For light paper or a dark screen."]
"""Of commands that draw."""

VerboseOption = Annotated[bool, "--verbose -v", "Print what is being done."]


def complete_run(ctx: typer.Context, incomplete: str) -> list[str]:
    """Runs of the workspace with this prefix, for shell completion."""
    named = ctx.params.get("workspace") or os.environ.get("TOPOBATCH_WORKSPACE")
    try:
        runs = Workspace(Path(named or USUAL)).runs()
    except (TopobatchError, OSError):
        return []
    return [run for run in runs if run.startswith(incomplete) and run.isprintable()]


RUNS = Extra(autocompletion=complete_run)


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """Which logs are read, and how."""

    odometry_topic: Annotated[
        str | None,
        "--odometry-topic TOPIC",
        "Odometry topic; default: the only one of the best known type, else /odom.",
    ] = None
    junction_topic: Annotated[
        str | None,
        "--junction-topic TOPIC",
        "Junction detections; default: /junctions, else the only PoseArray topic.",
    ] = None
    junction_fields: Annotated[
        str | None,
        "--junction-fields MAPPING",
        "How to read junctions from messages of another type, for instance "
        '"center=middle,branches=ways[].angle"; see docs/detections.md.',
    ] = None
    junctions_from: Annotated[
        Literal["topic", "scan", "cloud", "grid"] | None,
        "--junctions-from",
        "Where junctions come from: detections on a topic, or found in laser scans, clouds of "
        "points (sliced at the sensor's height), or the last occupancy grid; default: the first of "
        "these that the log has.",
    ] = None
    scan_topic: Annotated[
        str | None,
        "--scan-topic TOPIC",
        "Scans, clouds or grid to find junctions in; default: all lasers; else /points or /map, or "
        "the topic of its type with most messages.",
    ] = None
    laser_pose: Annotated[
        str | None,
        "--laser-pose X,Y,YAW",
        "Pose of the laser on the robot, in metres and radians; default: from /tf_static or /tf, "
        "else at the robot's centre, in the direction that its scans show, or ahead.",
    ] = None
    scan_stamp: Annotated[
        Literal["begin", "middle", "end"],
        "--scan-stamp",
        "Which beam of a sweep a scan's time stamp refers to. In ROS it is the first; some drivers "
        "stamp a scan when it is finished.",
    ] = "begin"
    cloud_band: Annotated[
        str | None,
        "--cloud-band LOW,HIGH",
        "Heights in the robot's frame between which points of a cloud are walls, in metres; "
        "default: 0.2 below to 0.2 above the sensor.",
    ] = None
    base_frame: Annotated[
        str | None,
        "--base-frame FRAME",
        "The robot's frame, if a topic such as /tf holds the odometry of several robots.",
    ] = None
    time: Annotated[
        Literal["header", "log"],
        "--time",
        "Take times from message headers or from when the log received them.",
    ] = "header"
    separate: Annotated[
        bool,
        "--separate",
        "Take parts of a split recording (run_0.bag, run_1.bag) as runs of their own.",
    ] = False
    allow_scan: Annotated[
        bool, "--allow-scan", "Read remote logs without an index whole, instead of refusing them."
    ] = False

    def settings(self, *, strict: bool = False) -> ReadSettings:
        """The settings; UsageError for numbers that are none."""
        from ..ingest.reading import ReadSettings
        from ..ingest.scans.slicing import SliceSettings

        finding = ("separate", "allow_scan", "laser_pose", "cloud_band")
        plain = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in finding}
        pose: Any = numbers(self.laser_pose, "--laser-pose", "x,y,yaw")
        band: Any = numbers(self.cloud_band, "--cloud-band", "low,high")
        return ReadSettings(laser_pose=pose, slices=SliceSettings(band), strict=strict, **plain)

    def logs(self, named: Sequence[str]) -> tuple[list[LogPath], list[tuple[LogPath, LogError]]]:
        """The logs at the named places, and the places without any, each with the reason."""
        from .run_logs import logs_of

        places = [log_path(name, allow_scan=self.allow_scan) for name in named]
        return logs_of(places, separate=self.separate)


@dataclass(frozen=True, slots=True)
class MapOptions:
    """How a map is made of what was read."""

    robot_radius: Annotated[
        float,
        "--robot-radius METRES",
        "Radius of the robot that has to fit through the corridors of a saved map or a grid.",
    ] = 0.25
    closure: Annotated[
        Literal["none", "full"],
        "--closure",
        "Whether to close loops: not at all, or by everything that is known.",
    ] = "full"

    def settings(self) -> MappingSettings:
        """The settings."""
        from ..ingest.mapping_settings import MappingSettings

        return MappingSettings(closure=self.closure, robot_radius_m=self.robot_radius)


def numbers(text: str | None, flag: str, names: str) -> tuple[float, ...] | None:
    """Comma-separated numbers, None for None; UsageError unless they are as many as `names`."""
    if text is None:
        return None
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) != len(names.split(",")):
        raise UsageError(f"{flag} is {text!r}, expected {names}, as in {flag}=0.2,0,0"[:200])
    return found


NAMES = (
    *(field.name for group in (ReadOptions, MapOptions) for field in fields(group)),
    "false_merge_rate",
)
"""Parameters of commands that a workspace may remember: what the robots are like, and how sure a
merge has to be. In the file they are called like the options."""


def settings_of(place: Workspace) -> dict[str, str]:
    """What a workspace remembers, by parameter, as its options take it; DocumentError with the
    place of the first fault if the file cannot be used."""
    path = place.settings_toml
    try:
        found = tomllib.loads(read_bytes(path).decode())
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (ValueError, RecursionError) as error:
        raise DocumentError(f"{path}: is no TOML: {error}") from error
    known = {option_name(name): name for name in NAMES}
    for key in found:
        if key not in known:
            raise DocumentError(f"{path}: knows no {key!r}; there are: {', '.join(known)}")
    return {known[key]: _text(value, f"{path}: {key}") for key, value in found.items()}


def option_name(name: str) -> str:
    """What a parameter's option is called in settings.toml."""
    return name.replace("_", "-")


def flag(name: str) -> str:
    """What it is called in a call."""
    return f"--{option_name(name)}"


def _text(value: Any, where: str) -> str:
    """A value as its option takes it: several numbers are joined by commas."""
    several = value if isinstance(value, list) else [value]
    if not all(type(part) in (str, int, float, bool) for part in several):
        raise DocumentError(f"{where}: text, number, true, false or a list of numbers expected")
    return ",".join(str(part) for part in several)


def settings_text(settings: Mapping[str, Any]) -> str:
    """The file that states these settings; inverse of `settings_of`. Texts and numbers are in TOML
    as in JSON, but that DEL is escaped."""
    texts = {
        name: json.dumps(settings[name], ensure_ascii=False).replace("\x7f", "\\u007f")
        for name in NAMES
        if name in settings
    }
    return "".join(f"{option_name(name)} = {text}\n" for name, text in texts.items())


def by_settings(context: typer.Context, place: Workspace) -> str:
    """What follows the line of a call in the journal: the options that it gave, of those that a
    workspace may remember, and those that it took from there."""
    given, rest = (describe_settings(taken(context, each)) for each in (GIVEN, REMEMBERED))
    parts = (given, rest and f"{place.settings_toml.name}: {rest}")
    return "".join(f"; {part}" for part in parts if part)


def describe_settings(settings: Mapping[str, Any]) -> str:
    """The settings in one line; "" without any."""
    return ", ".join(f"{option_name(name)} = {value}" for name, value in settings.items())
