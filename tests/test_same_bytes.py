"""The sample logs with detections give the same documents on any processor."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

SAMPLES = Path(__file__).parent.parent / "sample_logs"
# Not office-1: maps of lasers agree to the last digit of lengths, but not of all evidence.
LOGS = ("maze-1.mcap", "maze-2.bag", "maze-3", "streets-1.mcap")

# Processors by the kernels that linear algebra takes, and what numpy must not use to be like them.
PROCESSORS = {
    "Haswell": ("X86_V3", ("X86_V4", "AVX512")),
    "SkylakeX": ("X86_V4", ()),
    "Prescott": ("X86_V2", ("X86_V3", "X86_V4", "AVX", "FMA")),
}

MAKE = """
import sys
from pathlib import Path
from topobatch.ingest.mapping import build_map
from topobatch.ingest.reading import read_run
from topobatch.merge.document import write_merged
from topobatch.merge.merging import merge_maps
from topobatch.topology.document import read_map, write_map

out = Path(sys.argv[1])
for log in sys.argv[2:]:
    topomap = build_map(read_run(Path(log)))
    write_map(out / f"{topomap.run}.json", topomap)
write_merged(out / "merged.json", merge_maps([read_map(p) for p in sorted(out.glob("*.json"))]))
"""


MATCH = """
import numpy as np
from topobatch.ingest.scans.alignment import ALIGNMENT, Steps, align, match_steps
from topobatch.ingest.scans.association import Swept
from topobatch.topology.se2 import between

n, bearing = 60, np.radians(np.arange(-180, 180))
turn = 0.1 * np.arange(n) + 0.005
real = np.column_stack([np.linspace(1, 9, n), 2 + np.sin(np.arange(n) / 9), turn])
c, s = np.cos(real[:, 2:] + bearing), np.sin(real[:, 2:] + bearing)
x, y = real[:, :1], real[:, 1:2]
ranges = np.minimum(np.where(c > 0, 10 - x, -x) / c, np.where(s > 0, 4 - y, -y) / s)
ranges = np.round(ranges + 0.01 * np.sin(1e4 * ranges), 3)
xy = ranges[..., None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
scans = Swept.of(xy.astype(np.float32), np.full(n, -np.pi), np.full(n, np.radians(1)))
steps = Steps(1.1 * between(real[:-1], real[1:]), np.tile(100 * np.eye(3), (n - 1, 1, 1)))
rows = np.arange(n)
found = match_steps(scans, (rows[1:], rows[:-1]), steps, ALIGNMENT)
assert found.fit.min() > 0.5
earlier = [np.maximum(rows - back, -1) for back in ALIGNMENT.offsets]
start = real + 0.03 * np.sin(1e3 * real) * (rows > 0)[:, None]
aligned = align(scans, start, steps, fixed=1, earlier=earlier, settings=ALIGNMENT)
assert np.abs(between(real, aligned.pose)).max() < 0.03
print(found.motion.tobytes().hex(), aligned.pose.tobytes().hex())
"""


def environment(kernel: str) -> dict[str, str]:
    """Variables under which numpy and OpenBLAS take this machine for a processor of that kind."""
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

    without = PROCESSORS[kernel][1]
    off = [f for f in __cpu_dispatch__ if f.startswith(without) and __cpu_features__[f]]
    chosen = {"OPENBLAS_CORETYPE": kernel, "OPENBLAS_NUM_THREADS": "1"}
    return {**os.environ, **chosen, "NPY_DISABLE_CPU_FEATURES": " ".join(off if without else [])}


def runs_here(kernel: str) -> bool:
    from numpy._core._multiarray_umath import __cpu_features__

    needed = PROCESSORS[kernel][0]
    # Older numpy names single instruction sets.
    older = {"X86_V2": "SSE42", "X86_V3": "AVX2", "X86_V4": "AVX512_SKX"}[needed]
    return bool(__cpu_features__.get(needed) or __cpu_features__.get(older))


@pytest.fixture(scope="module")
def documents(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, bytes]]:
    """Bytes of every document, by processor."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        pytest.skip("kernels can be chosen on x86 alone")
    found = {}
    for kernel in filter(runs_here, PROCESSORS):
        out = tmp_path_factory.mktemp(kernel)
        command = [sys.executable, "-c", MAKE, str(out), *(str(SAMPLES / log) for log in LOGS)]
        subprocess.run(command, check=True, cwd=out, env=environment(kernel))
        found[kernel] = {path.name: path.read_bytes() for path in sorted(out.glob("*.json"))}
    return found


def test_documents_do_not_depend_on_the_processor(
    documents: dict[str, dict[str, bytes]],
) -> None:
    if len(documents) < 2:
        pytest.skip("this processor knows one kernel only")
    one, *others = documents.values()
    assert sorted(one) == sorted(["merged.json", *(f"{Path(log).stem}.json" for log in LOGS)])
    for other in others:
        assert [name for name in one if one[name] != other[name]] == []


def printed(code: str) -> list[bytes]:
    """What a program prints under every kernel that runs here."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        pytest.skip("kernels can be chosen on x86 alone")
    command = [sys.executable, "-c", code]
    return [
        subprocess.run(command, check=True, capture_output=True, env=environment(kernel)).stdout
        for kernel in filter(runs_here, PROCESSORS)
    ]


def test_the_processors_do_reckon_differently() -> None:
    """Else the other tests would say nothing."""
    x = "x = np.sin(np.arange(1, 4000.0)); A = x[:900].reshape(30, 30)"
    code = f"import numpy as np; {x}; print((A @ A.T).tobytes().hex(), np.exp(x).tobytes().hex())"
    out = printed(code)
    assert len(set(out)) == len(out)


def test_matched_scans_do_not_depend_on_the_processor() -> None:
    """To the last bit: what comes after decides by thresholds."""
    assert len(set(printed(MATCH))) == 1


def numbers(value: object, key: str = "") -> Iterator[tuple[str, float]]:
    """Every float of a document, with the last name on the way to it."""
    if isinstance(value, dict):
        for name, part in value.items():
            if name != "settings":
                yield from numbers(part, str(name))
    elif isinstance(value, list):
        for part in value:
            yield from numbers(part, key)
    elif isinstance(value, float):
        yield key, value


DECIMALS = {
    **dict.fromkeys(("x", "y", "length", "path", "rmse_m"), 3),
    **dict.fromkeys(("evidence_bits", "margin_bits", "bits", "same_place_bits"), 2),
    "branches": 4,
    "theta": 6,
}


def test_every_number_is_rounded_to_what_it_means(
    documents: dict[str, dict[str, bytes]],
) -> None:
    texts = next(iter(documents.values())).values()
    found = [pair for text in texts for pair in numbers(json.loads(text))]
    assert {key for key, _ in found} >= {"x", "theta", "length_sigma", "branches", "bits", "path"}
    for key, value in found:
        if key in DECIMALS:
            assert value == np.round(value, DECIMALS[key]), key
        else:  # sigmas, rates, calibration
            assert value == float(f"{value:.3e}"), key
