"""Choice of the topics of odometry, junction detections and sensors, with reasons."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Literal, NamedTuple

from ...topology.errors import LogError, UsageError
from .messages import Channel
from .poses import Kind

ODOMETRY_KINDS: Mapping[str, tuple[int, Kind]] = {
    "nav_msgs/msg/Odometry": (0, "odometry"),
    "tf2_msgs/msg/TFMessage": (1, "transforms"),
    "tf/msg/tfMessage": (1, "transforms"),
    "geometry_msgs/msg/PoseStamped": (2, "pose"),
    "foxglove.PoseInFrame": (3, "foxglove_pose"),
    "foxglove_msgs/msg/PoseInFrame": (3, "foxglove_pose"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (4, "pose_covariance"),
}
"""Types that can be odometry, with their order of preference."""

SET_BY_HAND = ("/initialpose",)
"""Topics with poses at which somebody put the robot, not driven ones: odometry only when named."""

JUNCTION_KINDS: Mapping[str, Kind] = {
    "geometry_msgs/msg/PoseArray": "pose_array",
    "foxglove.PosesInFrame": "foxglove_poses",
    "foxglove_msgs/msg/PosesInFrame": "foxglove_poses",
}

POSE_KINDS: Mapping[str, Kind] = {n: kind for n, (_, kind) in ODOMETRY_KINDS.items()} | dict(
    JUNCTION_KINDS
)
"""All types of poses."""


def decoded_alike(one: str, other: str) -> bool:
    """Whether messages of two types are decoded alike."""
    return one == other or (one in POSE_KINDS and POSE_KINDS[one] == POSE_KINDS.get(other))


PARTICLES = ("/particlecloud", "/particle_cloud")
"""Topics with many poses of the robot, not of a junction."""

TRANSFORM_KINDS = (
    "tf2_msgs/msg/TFMessage",
    "tf/msg/tfMessage",
    "foxglove.FrameTransform",
    "foxglove.FrameTransforms",
    "foxglove_msgs/msg/FrameTransform",
    "foxglove_msgs/msg/FrameTransforms",
)
"""Types with transforms between frames."""

Way = Literal["topic", "scan", "cloud", "grid"]
"""Source of junctions: detections, or found in scans, in point clouds, in a grid."""


class Role(NamedTuple):
    """What topics serve for. types: those accepted; named: these for people; usual: the topic that
    is preferred; flag: the option that names another one; noun: for people."""

    types: Collection[str]
    named: str
    usual: str
    flag: str
    noun: str = "what junctions are to be found in"


ODOMETRY = Role(
    tuple(ODOMETRY_KINDS),
    "nav_msgs/Odometry, tf, geometry_msgs/PoseStamped, PoseWithCovarianceStamped or "
    "foxglove.PoseInFrame",
    "/odom",
    "--odometry-topic",
    "the odometry",
)
JUNCTIONS: Mapping[Way, Role] = {
    "topic": Role(
        tuple(JUNCTION_KINDS),
        "geometry_msgs/PoseArray or foxglove.PosesInFrame",
        "/junctions",
        "--junction-topic",
        "the junction detections",
    ),
    "scan": Role(
        (
            "sensor_msgs/msg/LaserScan",
            "sensor_msgs/msg/MultiEchoLaserScan",
            "foxglove.LaserScan",
            "foxglove_msgs/msg/LaserScan",
        ),
        "sensor_msgs/LaserScan, MultiEchoLaserScan or foxglove.LaserScan",
        "/scan",
        "--scan-topic",
    ),
    "cloud": Role(
        ("sensor_msgs/msg/PointCloud2", "foxglove.PointCloud", "foxglove_msgs/msg/PointCloud"),
        "sensor_msgs/PointCloud2 or foxglove.PointCloud",
        "/points",
        "--scan-topic",
    ),
    "grid": Role(("nav_msgs/msg/OccupancyGrid",), "nav_msgs/OccupancyGrid", "/map", "--scan-topic"),
}
"""The sources of junctions, the preferred one first."""


@dataclass(frozen=True, slots=True)
class Choice:
    """A topic and the reason why it is used."""

    topic: str
    type_name: str
    why: str


def listing(counts: Mapping[Channel, int]) -> str:
    """The topics of a log in one line, for messages."""
    names = sorted({f"{c.topic} ({c.type_name or c.encoding})" for c, n in counts.items() if n})
    if not names:
        return "the log holds no messages"
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    return "topics: " + ", ".join(names[:12]) + more


def choose_odometry(counts: Mapping[Channel, int], named: str | None, log: str) -> list[Choice]:
    """The candidate odometry topics, most preferred type first.

    More than one is returned if only the content shows whether the first one is usable (tf). Raises
    LogError if there is none, UsageError if two topics of one type are candidates.
    """
    if named is not None:
        return [_named(counts, named, ODOMETRY, log)]
    choices: list[Choice] = []
    for rank in sorted({rank for rank, _ in ODOMETRY_KINDS.values()}):
        types = {name for name, (r, _) in ODOMETRY_KINDS.items() if r == rank}
        topics = _of_types(counts, types, without=("/tf_static",))
        topics = {name: kind for name, kind in topics.items() if not name.endswith(SET_BY_HAND)}
        if topics and not (choices and len(topics) > 1):
            choices.append(_single(topics, ODOMETRY, log))
        if rank == 0 and choices:
            break
    if not choices:
        raise LogError(f"{log}: no odometry found ({ODOMETRY.named}); {listing(counts)}")
    return choices


def odometry_topics(counts: Mapping[Channel, int]) -> list[str]:
    """The topics that could be odometry, but those of transforms, which serve for more."""
    kinds = {name for name, (_, kind) in ODOMETRY_KINDS.items() if kind != "transforms"}
    return sorted(_of_types(counts, kinds))


def choose_junctions(
    counts: Mapping[Channel, int], named: str | None, any_type: bool, log: str
) -> Choice:
    """The topic of junction detections.

    any_type: the caller names the fields to use, so that any type is accepted. Raises LogError if
    there is none, UsageError if there are several.
    """
    role = JUNCTIONS["topic"]
    if named is not None:
        return _named(counts, named, role, log, any_type=any_type)
    if any_type:
        every = _of_types(counts, {channel.type_name for channel in counts})
        if "/junctions" in every:
            return Choice("/junctions", every["/junctions"], "default name")
        raise UsageError(f"{log}: --junction-fields needs --junction-topic; {listing(counts)}")
    topics = _of_types(counts, role.types)
    # What a particle filter believes of the robot's own pose.
    topics = {name: kind for name, kind in topics.items() if not name.endswith(PARTICLES)}
    if not topics:
        raise LogError(
            f"{log}: no junction detections found ({role.named}); {listing(counts)}; if one of "
            "them holds junctions, name it by --junction-topic and its fields by --junction-fields"
        )
    return _single(topics, role, log)


def choose_sensors(
    counts: Mapping[Channel, int], named: str | None, role: Role, log: str
) -> list[Choice]:
    """The topics of scans, clouds or grids: the usual one first, then those with most messages.

    Raises LogError if there is none. Cost maps, which a planner derives from a map, are used only
    when named.
    """
    if named is not None:
        return [_named(counts, named, role, log)]
    topics = _of_types(counts, role.types)
    topics = {name: kind for name, kind in topics.items() if "costmap" not in name}
    if not topics:
        raise LogError(
            f"{log}: nothing found to detect junctions in ({role.named}); {listing(counts)}"
        )
    if len(topics) == 1:
        return [_single(topics, role, log)]
    messages = {name: sum(n for c, n in counts.items() if c.topic == name) for name in topics}
    ranked = sorted(topics, key=lambda name: (name != role.usual, -messages[name], name))
    why = "default name" if ranked[0] == role.usual else "most messages"
    return [Choice(ranked[0], topics[ranked[0]], f"{why}, out of several topics of its type")] + [
        Choice(name, topics[name], "one of several topics of its type") for name in ranked[1:]
    ]


def _of_types(
    counts: Mapping[Channel, int], types: Iterable[str], without: tuple[str, ...] = ()
) -> dict[str, str]:
    wanted = set(types)
    return {
        channel.topic: channel.type_name
        for channel, count in sorted(counts.items())
        if count and channel.type_name in wanted and channel.topic not in without
    }


def _single(topics: dict[str, str], role: Role, log: str) -> Choice:
    if len(topics) == 1:
        ((topic, type_name),) = topics.items()
        why = "default name" if topic == role.usual else "the only topic of its type"
        return Choice(topic, type_name, why)
    if role.usual in topics:
        why = "default name, out of several topics of its type"
        return Choice(role.usual, topics[role.usual], why)
    names = ", ".join(sorted(topics))
    raise UsageError(
        f"{log}: {len(topics)} topics could be {role.noun}: {names}; choose with {role.flag}"
    )


def _named(
    counts: Mapping[Channel, int], named: str, role: Role, log: str, *, any_type: bool = False
) -> Choice:
    named, flag = "/" + named.strip("/"), role.flag
    for channel, count in sorted(counts.items()):
        if channel.topic == named and count:
            if not any_type and channel.type_name not in role.types:
                raise UsageError(
                    f"{log}: {named} is {channel.type_name}, but {flag} needs {role.named}"
                )
            return Choice(named, channel.type_name, f"named by {flag}")
    types = {channel.type_name for channel in counts} if any_type else role.types
    near = _like(named, _of_types(counts, types))
    meant = f"; did you mean {near}?" if near else ";"
    raise LogError(f"{log}: no messages of {named} ({flag}){meant} {listing(counts)}")


def _like(named: str, topics: Iterable[str]) -> str | None:
    """A topic that may be meant by a name that none has: with other namespaces, or misspelt."""
    longer = sorted(topic for topic in topics if topic.endswith(named))
    return next(iter(longer or get_close_matches(named, sorted(topics), 1)), None)
