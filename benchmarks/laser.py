"""Junctions from scans: python benchmarks/laser.py FOLDER... [--alone] [--kiss]

Folders hold `logs/*.mcap` with odometry and a laser, `truth.json` with corrected paths; or are what
`topobatch simulate OUT --laser --format mcap` writes, of which the truth is exact. Per run:

  drift       error of the position after 5 and 20 m of way, of the odometry as recorded and as
              corrected: median and 90 % of all stretches, and of those between moments at which the
              robot drives straight (the truth is interpolated between scans far apart: in turns it
              is off by degrees); `framed`: the same between rigid fits of 4 m of way around both
              ends, which a single wrong heading of the truth does not swing around; `bent`: what is
              left at the ends of a stretch after the best rigid fit of all of it
  agreed      of real logs: the same errors against what the scans of the whole log agree on
              (`revisits.py`), of the corrected odometry, of the truth, and of what the scans agree
              on with hardly any odometry beside them; how many points of places passed again fit
  claimed     shares of heading errors after 20 m within the 68.3 and 95.4 % that the run's noise
              claims, with the truth's own scatter (as it is over 0.5 m, no normal one) in it
  junctions   of simulated worlds: passes within 0.7 m, or within a corridor's width, of a crossing;
              crossings passed (not in the first or last 8 s) that were found; with the branches
              that they have
  ends        of simulated worlds: dead ends that the robot came to, those with a turning point (or
              a track end) of the map where the robot was within 1 m; turning points at dead ends
  repeat      of the times that a place with a junction was passed again: found within 0.5 m, and
              with the same number of branches. A place counts as passed when the truth comes within
              0.9 m; "sure": of junctions on which 6 of 7 variants agree
  closure     pairs of passes by one place (0.6 m) that were identified, pairs that were though more
              than 2 m apart; rmse of all passes after the best rigid fit of the map
  covered     share of the way that corridors of the map stand for, by their lengths; by the way
              driven, that along corridors (also to turning points and back), and that out of a
              junction and back to it which none stands for
  speed       seconds of log per second of one core, for the chain and the map; peak memory

--alone leaves the odometry out. --kiss runs KISS-ICP (no dependency of ours) on the same scans, one
thread, the recorded motion as its prior. Pictures: walls, junctions; the map beside it.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from revisits import revisits
from scipy.special import ndtr

from topobatch.ingest.logs.recording import recording_at
from topobatch.ingest.mapping import build_map
from topobatch.ingest.scans.detection import detect
from topobatch.ingest.scans.matching import matched, posed
from topobatch.ingest.scans.scan import ScanBatch, ScanResult
from topobatch.ingest.scans.stream import Mounting, ScanStream
from topobatch.ingest.scans.turns import LaggingError
from topobatch.topology.odometry import Odometry
from topobatch.topology.ragged import Ragged
from topobatch.topology.run import Detections, Run
from topobatch.topology.se2 import apply, between, compose, fit_rigid, inverse, wrap
from topobatch.topology.topomap import RunNoise, TopoMap
from topobatch.topology.track import way_at
from topobatch.topology.turning_points import TURNING_POINT
from topobatch.topology.turning_vertices import with_turning_points

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

STRAIGHT_RAD_PER_S = 0.05
REPEAT_M, PASSED_M, SAME_PASS_M = 0.5, 0.9, 2.5
ONE_PLACE_M, APART_M = 0.6, 2.0


@dataclass(frozen=True)
class Crossings:
    """Of a simulated world: xy (v, 2) and number of branches (v,) of all vertices; passes of them
    by time, [ns]."""

    xy: FloatArray
    degree: IntArray
    vertex: IntArray
    start_ns: IntArray
    end_ns: IntArray


@dataclass(frozen=True)
class Log:
    """Odometry, scans, and the corrected path of a run; crossings: of a simulated one."""

    name: str
    odometry: Odometry
    scans: list[ScanBatch]
    truth: Odometry
    crossings: Crossings | None = None

    @property
    def seconds(self) -> float:
        return float(self.scans[-1].times_ns[-1] - self.scans[0].times_ns[0]) * 1e-9


def logs(folder: Path) -> Iterator[Log]:
    """The runs of a folder, their odometry and real scans read by rosbags."""
    told = json.loads((folder / "truth.json").read_text())
    for name, run in sorted(told["runs"].items()):
        simulated = "laser" in run.get("settings", {})
        path = folder / ("" if simulated else "logs") / f"{name}.mcap"
        odometry, scans = _read(path)
        rows = {row[0]: row[1:] for row in odometry}
        times = np.array(sorted(rows), np.int64)
        track = Odometry(times, np.array([rows[t] for t in times]), np.zeros(0, np.int64))
        real = Odometry(
            np.array([row[0] for row in run["path"]], np.int64),
            np.array([row[1:] for row in run["path"]]),
            np.zeros(0, np.int64),
        )
        if simulated:
            crossings = _crossings(told["worlds"][run["world"]], run)
            batches = _mounted(path, run["settings"]["laser"]["mount"])
            yield Log(f"{folder.name}/{name}", track, batches, real, crossings)
        else:
            yield Log(name, track, list(_batches(scans)), real)


def _read(path: Path) -> tuple[list[tuple[int, float, float, float]], list[Any]]:
    from rosbags.highlevel import AnyReader

    odometry, scans = [], []
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            if connection.msgtype.endswith("/Odometry"):
                odometry.append(_pose(reader.deserialize(raw, connection.msgtype)))
            elif connection.msgtype.endswith("/LaserScan"):
                scans.append(reader.deserialize(raw, connection.msgtype))
    return odometry, scans


def _mounted(path: Path, mount: list[float]) -> list[ScanBatch]:
    """Simulated scans, which begin at their stamps, as `topobatch ingest` reads them."""
    x, y, yaw = mount
    pose = np.array([x, y, 0.0, 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)])
    return list(ScanStream(recording_at(path), "/scan", Mounting(otherwise=lambda _: pose)))


def _crossings(world: Any, run: Any) -> Crossings:
    xy = np.array(world["vertices"], float)[:, :2]
    open_ = [e for k, e in enumerate(world["edges"]) if k not in set(run["closed_edges"])]
    ends = np.array([edge[:2] for edge in open_])
    passes = {k: np.array(run["passes"][k], np.int64) for k in ("vertex", "start_ns", "end_ns")}
    return Crossings(xy, np.bincount(ends.ravel(), minlength=len(xy)), **passes)


def _ns(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _pose(message: Any) -> tuple[int, float, float, float]:
    p, q = message.pose.pose.position, message.pose.pose.orientation
    return _ns(message.header.stamp), p.x, p.y, float(2 * np.arctan2(q.z, q.w))


def _batches(messages: list[Any], size: int = 200) -> Iterator[ScanBatch]:
    messages = sorted(messages, key=lambda m: _ns(m.header.stamp))
    for k in range(0, len(messages), size):
        part = messages[k : k + size]
        first = part[0]
        ranges = np.array([m.ranges for m in part], np.float32)
        ranges[~((ranges > first.range_min) & (ranges < first.range_max))] = np.nan
        angles = first.angle_min + first.angle_increment * np.arange(ranges.shape[1])
        times = np.array([_ns(m.header.stamp) for m in part], np.int64)
        yield ScanBatch(times, ranges, float(first.range_max), angles)


def corrected_at(result: ScanResult, log: Log, time_ns: IntArray) -> FloatArray:
    """Corrected poses between keyframes."""
    if not result.statistics.odometry or len(result.odometry.time_ns) < 2:
        return result.odometry.at(time_ns)
    return bent_onto(result.odometry, log, time_ns)


def bent_onto(keyframes: Odometry, log: Log, time_ns: IntArray) -> FloatArray:
    """Poses between keyframes: recorded motion, bent onto the keyframes either side."""
    t, T = keyframes.time_ns, keyframes.pose
    raw = log.odometry.at
    a = np.clip(np.searchsorted(t, time_ns, side="right") - 1, 0, len(t) - 2)
    share = np.clip((time_ns - t[a]) / (t[a + 1] - t[a]), 0, 1)[:, None]
    ahead = compose(T[a], between(raw(t[a]), raw(time_ns)))
    back = compose(T[a + 1], between(raw(t[a + 1]), raw(time_ns)))
    off = np.column_stack([back[:, :2] - ahead[:, :2], wrap(back[:, 2] - ahead[:, 2])])
    return np.asarray(ahead + share * off)


@dataclass(frozen=True)
class Stretches:
    """Pieces of way of one length: errors (q, 3) of the motion, straight at both ends, bent."""

    error: FloatArray
    straight: NDArray[np.bool_]
    bent: FloatArray
    turned: FloatArray
    framed: FloatArray

    @classmethod
    def of(cls, log: Log, time_ns: IntArray, ours: FloatArray, way_m: float) -> Stretches:
        real = log.truth.at(time_ns)
        way = way_at(log.truth, time_ns)
        last = np.searchsorted(way, way + way_m)
        first = np.flatnonzero(last < len(way))
        last = last[first]
        around = np.int64(3e8)
        turn = log.odometry.at(time_ns + around)[:, 2] - log.odometry.at(time_ns - around)[:, 2]
        calm = np.abs(wrap(turn)) / 0.6 < STRAIGHT_RAD_PER_S
        total = np.concatenate([[0.0], np.cumsum(np.abs(wrap(np.diff(real[:, 2]))))])
        error = between(between(real[first], real[last]), between(ours[first], ours[last]))
        bent = [_bent(real[a : b + 1], ours[a : b + 1]) for a, b in zip(first, last, strict=True)]
        framed = _framed(real, ours, way, np.stack([first, last]))
        return cls(
            error, calm[first] & calm[last], np.array(bent), total[last] - total[first], framed
        )

    @property
    def off_m(self) -> FloatArray:
        return np.hypot(self.error[:, 0], self.error[:, 1])

    def told(self) -> str:
        if len(self.error) == 0:
            return "too short"
        everywhere, calm = self.off_m, self.off_m[self.straight]
        calm = calm if len(calm) else np.array([np.nan])
        return (
            f"median {np.median(everywhere):.3f} p90 {np.percentile(everywhere, 90):.3f}; straight "
            f"{np.median(calm):.3f} {np.percentile(calm, 90):.3f}; framed "
            f"{np.median(self.framed):.3f} {np.percentile(self.framed, 90):.3f}; bent p90 "
            f"{np.percentile(self.bent, 90):.3f} m"
        )


def _bent(real: FloatArray, ours: FloatArray) -> float:
    T = fit_rigid(real[:, :2], ours[:, :2])
    off = real[[0, -1], :2] - apply(T, ours[[0, -1], :2])
    return float(np.hypot(*off.T).max())


def _framed(
    real: FloatArray, ours: FloatArray, way: FloatArray, ends: IntArray, half_m: float = 2.0
) -> FloatArray:
    """(q,) error [m] of the last places seen from the first, both by fits of the way around."""
    around = [np.searchsorted(way, [w - half_m, w + half_m]) for w in way]
    fits = np.array(
        [fit_rigid(real[a:b, :2], ours[a:b, :2]) if b - a > 3 else [np.nan] * 3 for a, b in around]
    )
    first, last = ends
    off = apply(fits[first], ours[last, :2]) - apply(fits[last], ours[last, :2])
    distance = np.hypot(off[:, 0], off[:, 1])
    return distance[np.isfinite(distance)]


def agreed(log: Log) -> Log:
    """The log, its truth replaced by what its scans agree on; what that is worth is printed."""
    seen = revisits(log.odometry, log.scans, log.truth)
    out = replace(log, truth=seen.path)
    t = seen.path.time_ns
    for way_m in (5.0, 20.0):
        for name, path in (("truth", log.truth), ("itself", seen.loose)):
            print(
                f"  agreed {way_m:2.0f} m {name} {Stretches.of(out, t, path.at(t), way_m).told()}"
            )
    print(
        f"  agreed   {seen.fit:.2f} of the points of {seen.pairs} pairs of visits of a place fit, "
        f"{seen.fit_truth:.2f} by the truth"
    )
    return out


def matching_rate(log: Log) -> float:
    """Scans per second of scan matching alone, which is what KISS-ICP does."""
    began = time.process_time()
    for _ in matched(posed(log.odometry, log.scans)):
        pass
    return sum(map(len, log.scans)) / (time.process_time() - began)


def claimed(log: Log, result: ScanResult, time_ns: IntArray, ours: FloatArray) -> str:
    """Shares of heading errors after 20 m within the central 68.3 and 95.4 % claimed."""
    told = []
    for name, p in central(log, result.scanned.noise, time_ns, ours).items():
        told.append(f"{name} {np.mean(p < 0.683):.3f} {np.mean(p < 0.954):.3f} (n {len(p)})")
    return "within 68.3 and 95.4 %: " + ", ".join(told) if told else "too short"


def central(
    log: Log, noise: RunNoise, time_ns: IntArray, ours: FloatArray
) -> dict[str, FloatArray]:
    """By stretches of 20 m, straight at both ends and all, (q,) the share of errors, by the run's
    noise and the truth's own scatter, that is smaller than the one found; empty if too short."""
    base = Stretches.of(log, time_ns, ours, 0.5)
    far = Stretches.of(log, time_ns, ours, 20.0)
    out = {}
    for name, near_rows, rows in (
        ("straight", base.straight, far.straight),
        ("all", base.straight | True, far.straight | True),
    ):
        if not rows.any() or not near_rows.any():
            continue
        own = base.error[near_rows, 2]
        own = np.quantile(own - np.median(own), np.linspace(0.005, 0.995, 100))
        walk = noise.heading_rad_per_sqrt_m**2 * 20
        walk = walk + noise.heading_rad_per_sqrt_rad**2 * far.turned[rows]
        sigma, off = np.sqrt(walk)[:, None], np.abs(far.error[rows, 2])[:, None]
        out[name] = (ndtr((off - own) / sigma) - ndtr((-off - own) / sigma)).mean(axis=1)
    return out


def junctions(log: Log, result: ScanResult) -> str:
    """Passes against the crossings of a simulated world."""
    known, passes = log.crossings, result.scanned.passes
    assert known is not None
    centre, degree = true_centres(log, result), passes.branches.counts
    away = np.hypot(*(centre[:, None] - known.xy).transpose(2, 0, 1))
    real = np.where(known.degree >= 3, away, np.inf)
    nearest = real.argmin(axis=1)
    ends = log.truth.time_ns[[0, -1]] + np.array([8, -8]) * 10**9
    inner = (known.start_ns > ends[0]) & (known.end_ns < ends[1])
    asked = np.flatnonzero(inner & (known.degree[known.vertex] >= 3))
    told = []
    for reach_m in (0.7, 1.4):
        right = real.min(axis=1) < reach_m
        found, same = [], []
        for k in asked.tolist():
            then = (passes.end_ns >= known.start_ns[k] - 3 * 10**9) & (
                passes.start_ns <= known.end_ns[k] + 3 * 10**9
            )
            there = then & (away[:, known.vertex[k]] < reach_m)
            found.append(bool(there.any()))
            same.append(bool((degree[there] == known.degree[known.vertex[k]]).any()))
        alike = right & (degree == known.degree[nearest])
        told.append(
            f"{reach_m} m: precision {np.mean(right):.3f} recall {np.mean(found):.3f}, with the "
            f"same branches {np.mean(alike):.3f} {np.mean(same):.3f}"
        )
    return "; ".join(told) + f" (of {len(centre)}, {len(asked)})"


def true_centres(log: Log, result: ScanResult) -> FloatArray:
    """(p, 2) centres of the passes in the truth's frame, by 8 m of way around each."""
    return true_passes(log, result)[0]


def true_passes(log: Log, result: ScanResult) -> tuple[FloatArray, FloatArray]:
    """`true_centres`, and (p,) by how much the odometry's frame is turned to the truth's there."""
    passes, odometry = result.scanned.passes, result.odometry
    way = way_at(odometry, log.truth.time_ns)
    at = way_at(odometry, passes.time_ns)
    own = odometry.at(log.truth.time_ns)[:, :2]
    centre = apply(odometry.at(passes.time_ns), passes.centre)
    out, turn = np.empty_like(centre), np.empty(len(passes))
    for k in range(len(passes)):
        near = np.abs(way - at[k]) < 4.0
        T = fit_rigid(log.truth.pose[near, :2], own[near])
        out[k], turn[k] = apply(T, centre[k]), T[2]
    return out, turn


def dead_ends(crossings: Crossings, truth: Odometry, topomap: TopoMap) -> str:
    """Turning points of a map against the dead ends that the robot came to."""
    points = topomap.turning_points
    at = truth.at(np.array([times[0, 0] for times in points.time_ns], np.int64))[:, :2]
    dead = np.flatnonzero(crossings.degree == 1)
    near = np.hypot(*(at[:, None] - crossings.xy[dead]).transpose(2, 0, 1)) < 1.0
    come = np.isin(dead, crossings.vertex)
    turned = np.array([kind == TURNING_POINT for kind in points.kind], bool)
    return (
        f"{np.count_nonzero(near.any(axis=0) & come)} of {np.count_nonzero(come)} dead ends found; "
        f"{np.count_nonzero(near.any(axis=1) & turned)} of {np.count_nonzero(turned)} turning "
        "points at dead ends"
    )


def repeatability(log: Log, result: ScanResult) -> str:
    passes, centre = result.scanned.passes, true_centres(log, result)
    degree = passes.branches.counts
    time_ns = result.odometry.time_ns
    way, at = way_at(result.odometry, time_ns), way_at(result.odometry, passes.time_ns)
    xy = log.truth.at(time_ns)[:, :2]
    found, same, sure = [], [], []
    for k in range(len(passes)):
        for begin, end in _visits(np.hypot(*(xy - centre[k]).T) < PASSED_M, way):
            if begin - SAME_PASS_M <= at[k] <= end + SAME_PASS_M or end < 1 or begin > way[-1] - 1:
                continue
            there = (at >= begin - SAME_PASS_M) & (at <= end + SAME_PASS_M)
            there &= np.hypot(*(centre - centre[k]).T) < REPEAT_M
            found.append(bool(there.any()))
            same.append(bool((degree[there] == degree[k]).any()))
            sure.append(bool(passes.confidence[k] > 5.5 / 7))
    if not found:
        return "nothing passed again"
    confident = np.array(same)[np.array(sure)]
    return (
        f"{np.mean(found):.3f} found, {np.mean(same):.3f} with the same branches of {len(found)}; "
        f"sure {np.mean(confident) if len(confident) else np.nan:.3f} of {len(confident)}"
    )


def _visits(inside: NDArray[np.bool_], way: FloatArray) -> list[tuple[float, float]]:
    """Stretches of way on which the robot was there; less than 3 m away in between is one visit."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    out: list[tuple[float, float]] = []
    for a, b in zip(edges[::2], edges[1::2] - 1, strict=True):
        if out and way[a] - out[-1][1] < 3.0:
            out[-1] = out[-1][0], float(way[b])
        else:
            out.append((float(way[a]), float(way[b])))
    return out


def closure(log: Log, result: ScanResult, topomap: TopoMap) -> str:
    times = topomap.observation_time_ns
    # Two junctions may be passed at one moment.
    again = np.arange(len(times)) - np.searchsorted(times, times)
    row = np.searchsorted(result.scanned.passes.time_ns, times) + again
    centre = true_centres(log, result)[np.minimum(row, len(result.scanned.passes) - 1)]
    home = topomap.observation_vertex
    a, b = np.triu_indices(len(home), 1)
    apart, one = np.hypot(*(centre[a] - centre[b]).T), home[a] == home[b]
    near = apart < ONE_PLACE_M
    T = fit_rigid(centre, topomap.xy[home])
    off = np.hypot(*(centre - apply(T, topomap.xy[home])).T)
    recall = f"{np.mean(one[near]):.3f}" if near.any() else "-"
    return (
        f"{recall} of {near.sum()} identified, {np.sum(one & (apart > APART_M))} of {one.sum()} "
        f"false; rmse {np.sqrt(np.mean(off**2)):.3f} m; {len(topomap.xy)} vertices, "
        f"{len(topomap.source)} corridors"
    )


def judge(log: Log, *, alone: bool, pictures: Path | None) -> Log:
    """Print all about a log; the log, with the best truth there is."""
    began = time.process_time()
    odometry = None if alone else log.odometry
    try:
        result = detect(odometry, log.scans)
    except LaggingError as error:  # as `topobatch ingest` goes on
        if odometry is None:
            raise
        result = detect(odometry.delayed(error.lag_s), log.scans, may_lag=False)
    detected = time.process_time()
    none = Detections(np.zeros(0, np.int64), np.zeros((0, 2)), Ragged.from_rows([]))
    run = Run(log.name, result.odometry, none, scanned=result.scanned)
    topomap = build_map(run)
    done = time.process_time()
    t = log.truth.time_ns
    t = t[(t >= result.odometry.time_ns[0]) & (t <= result.odometry.time_ns[-1])]
    ours = corrected_at(result, log, t)
    print(f"{log.name}: {log.seconds:.0f} s, {way_at(log.truth, t)[-1]:.0f} m")
    for way_m in (5.0, 20.0):
        recorded = Stretches.of(log, t, log.odometry.at(t), way_m)
        print(f"  drift {way_m:2.0f} m recorded  {recorded.told()}")
        print(f"  drift {way_m:2.0f} m corrected {Stretches.of(log, t, ours, way_m).told()}")
    print(f"  claimed  {claimed(log, result, t, ours)}")
    if log.crossings is not None:
        print(f"  junctions {junctions(log, result)}")
        print(f"  ends     {dead_ends(log.crossings, log.truth, topomap)}")
    print(f"  repeat   {repeatability(log, result)}")
    print(f"  closure  {closure(log, result, topomap)}")
    way = way_at(result.odometry, result.odometry.time_ns[-1:])[0]
    driven, whole = topomap.info["driven"], with_turning_points(topomap)
    print(
        f"  covered  {whole.length @ whole.traversals / way:.2f} of {way:.0f} m; along "
        f"corridors {driven['corridors']:.2f}, out and back {driven['out_and_back']:.2f}"
    )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    spent, total = detected - began, done - began
    print(
        f"  speed    {log.seconds / total:.0f} x real time ({spent:.1f} s scans, "
        f"{done - detected:.1f} s map), {result.statistics.scans / spent:.0f} scans/s; "
        f"peak {peak:.0f} MB with all scans held",
        flush=True,
    )
    if not alone:
        print(f"  speed    {matching_rate(log):.0f} scans/s by matching alone")
    if pictures is not None:
        draw(pictures / f"{log.name}.png", result, topomap)
    if log.crossings is not None or alone:
        return log
    log = agreed(log)
    t = log.truth.time_ns
    for way_m in (5.0, 20.0):
        told = Stretches.of(log, t, corrected_at(result, log, t), way_m).told()
        print(f"  agreed {way_m:2.0f} m corrected {told}", flush=True)
    print(f"  agreed   {claimed(log, result, t, corrected_at(result, log, t))}")
    return log


def draw(path: Path, result: ScanResult, topomap: TopoMap) -> None:
    """Walls of views and passes on the corrected track, and beside it the map."""
    from PIL import Image, ImageDraw

    walls, _ = result.scanned.views.walls()
    low, high = walls.min(axis=0) - 1, walls.max(axis=0) + 1
    scale = 1400 / float((high - low).max())
    width, height = ((high - low) * scale).astype(int).tolist()
    image = Image.new("RGB", (2 * width, height), "white")
    pen = ImageDraw.Draw(image)

    def at(xy: FloatArray, offset: float = 0.0) -> list[tuple[float, float]]:
        x, y = ((np.atleast_2d(xy) - low) * scale).T
        return list(zip((x + offset).tolist(), (height - y).tolist(), strict=True))

    pen.point(at(walls), fill=(150, 150, 150))
    pen.line(at(result.odometry.pose[:, :2]), fill=(90, 120, 230))
    pose = result.odometry.at(result.scanned.passes.time_ns)
    for k, centre in enumerate(apply(pose, result.scanned.passes.centre)):
        strong = result.scanned.passes.confidence[k] > 5.5 / 7
        _star(pen, at, centre, result.scanned.passes.branches[k] + pose[k, 2], 0.0, strong=strong)
    T = fit_rigid(
        result.odometry.at(topomap.observation_time_ns)[:, :2],
        topomap.xy[topomap.observation_vertex],
    )
    for line in topomap.paths:
        pen.line(at(apply(T, line), width), fill=(60, 60, 220), width=2)
    for k, centre in enumerate(apply(T, topomap.xy)):
        _star(pen, at, centre, topomap.branches[k] + T[2], width, strong=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    image.save(path)


def _star(
    pen: Any, at: Any, centre: FloatArray, headings: FloatArray, offset: float, *, strong: bool
) -> None:
    colour = (220, 0, 0) if strong else (230, 140, 0)
    ((x, y),) = at(centre, offset)
    pen.ellipse([x - 4, y - 4, x + 4, y + 4], outline=colour, width=2)
    for heading in headings:
        (end,) = at(centre + 0.8 * np.array([np.cos(heading), np.sin(heading)]), offset)
        pen.line([(x, y), end], fill=colour, width=2)


def kiss(log: Log) -> None:
    """The same scans through KISS-ICP, as points in the plane, one thread."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    config = KISSConfig()
    config.data.deskew, config.data.max_range, config.data.min_range = False, 40.0, 0.1
    config.mapping.voxel_size = 0.5
    config.registration.max_num_threads = 1
    odometry = KissICP(config)
    poses, times = [], []
    last = None
    began = time.process_time()
    for batch in log.scans:
        for row in range(len(batch)):
            r = batch.ranges_m[row].astype(float)
            seen = np.isfinite(r)
            points = np.column_stack([r * np.cos(batch.angles_rad), r * np.sin(batch.angles_rad)])
            cloud = np.column_stack([points[seen], np.zeros(seen.sum())])
            wheel = compose(log.odometry.at(batch.times_ns[row : row + 1])[0], batch.T_body_laser)
            if last is not None:
                odometry.last_delta = _lifted(between(last, wheel))
            last = wheel
            odometry.register_frame(cloud, np.zeros(len(cloud)))
            T = odometry.last_pose
            laser = np.array([T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])])
            poses.append(compose(laser, inverse(batch.T_body_laser)))
            times.append(int(batch.times_ns[row]))
    spent = time.process_time() - began
    keep = np.concatenate([[True], np.diff(times) > 0])
    track = Odometry(np.array(times)[keep], np.array(poses)[keep], np.zeros(0, np.int64))
    t = log.truth.time_ns
    t = t[(t >= track.time_ns[0]) & (t <= track.time_ns[-1])]
    for way_m in (5.0, 20.0):
        print(f"  KISS-ICP {way_m:2.0f} m {Stretches.of(log, t, track.at(t), way_m).told()}")
    print(f"  KISS-ICP {len(times) / spent:.0f} scans/s", flush=True)


def _lifted(motion: FloatArray) -> FloatArray:
    out = np.eye(4)
    c, s = np.cos(motion[2]), np.sin(motion[2])
    out[:2, :2] = [[c, -s], [s, c]]
    out[:2, 3] = motion[:2]
    return out


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--alone", action="store_true", help="leave the odometry out")
    parser.add_argument("--kiss", action="store_true", help="KISS-ICP as well, if installed")
    parser.add_argument("--pictures", type=Path, help="draw every run into this folder")
    options = parser.parse_args()
    for folder in options.folders:
        for log in logs(folder):
            best = judge(log, alone=options.alone, pictures=options.pictures)
            if options.kiss:
                kiss(best)


if __name__ == "__main__":
    main()
