"""The sample logs with detections give the same documents on any processor."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from topobatch.ingest.mapping import build_map
from topobatch.ingest.reading import read_run
from topobatch.merge.document import merged_to_document
from topobatch.merge.merging import merge_maps
from topobatch.topology.document import map_to_document

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


def documents(kernel: str, out: Path) -> dict[str, bytes]:
    """Bytes of every document, made in a folder."""
    out.mkdir()
    command = [sys.executable, "-c", MAKE, str(out), *(str(SAMPLES / log) for log in LOGS)]
    subprocess.run(command, check=True, cwd=out, env=environment(kernel))
    return {path.name: path.read_bytes() for path in sorted(out.glob("*.json"))}


@pytest.mark.slow
def test_documents_do_not_depend_on_the_processor(tmp_path: Path) -> None:
    if platform.machine().lower() not in ("x86_64", "amd64"):
        pytest.skip("kernels can be chosen on x86 alone")
    one, *others = (
        documents(kernel, tmp_path / kernel) for kernel in filter(runs_here, PROCESSORS)
    )
    assert sorted(one) == sorted(["merged.json", *(f"{Path(log).stem}.json" for log in LOGS)])
    for other in others:
        assert [name for name in one if one[name] != other[name]] == []


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


def test_every_number_is_rounded_to_what_it_means() -> None:
    maps = [build_map(read_run(SAMPLES / log)) for log in LOGS[:2]]
    told = [*map(map_to_document, maps), merged_to_document(merge_maps(maps))]
    found = [pair for document in told for pair in numbers(document)]
    assert {key for key, _ in found} >= {"x", "theta", "length_sigma", "branches", "bits", "path"}
    for key, value in found:
        if key in DECIMALS:
            assert value == np.round(value, DECIMALS[key]), key
        else:  # sigmas, rates, calibration
            assert value == float(f"{value:.3e}"), key
