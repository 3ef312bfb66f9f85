"""A few of the fuzzing harness's inputs; `python tests/ingest/fuzz_logs.py` tries many more."""

from __future__ import annotations


def test_the_samples_themselves_are_read_whole(fuzz, tmp_path):
    from topobatch.ingest.reading import read_run

    for name, path in fuzz.corpus(tmp_path).items():
        run = read_run(path)
        assert len(run.odometry) + len(run.detections) == fuzz.MESSAGES, name


def test_mutated_logs_are_read_or_refused(fuzz, tmp_path):
    samples = fuzz.corpus(tmp_path / "corpus")
    work = tmp_path / "work"
    work.mkdir()
    found = list(fuzz.failures(samples, 420, 1, work))
    assert [(name, number, problem) for name, number, problem, _ in found] == []
