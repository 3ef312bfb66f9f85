"""Colours of runs: as many as there are runs, and light enough for names."""

from __future__ import annotations

import numpy as np

from topobatch.viz import palette


def contrast(colour: tuple[int, int, int]) -> float:
    """To the background of the viewer, by WCAG 2.1."""

    def luminance(rgb: tuple[int, int, int]) -> float:
        c = np.array(rgb) / 255
        linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
        return float(linear @ (0.2126, 0.7152, 0.0722))

    return (luminance(colour) + 0.05) / (luminance(palette.BACKGROUND) + 0.05)


def test_the_names_of_two_hundred_runs_can_be_read() -> None:
    colours = [palette.of_rank(rank) for rank in range(200)]
    assert len(set(colours)) == 200
    assert min(map(contrast, colours)) >= 4.5
