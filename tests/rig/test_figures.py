"""What figures say beside their lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rig.report.page import MOST_POINTS, log_scale, new_figure, saved, thinned


@pytest.mark.parametrize(
    ("low_ohm", "high_ohm", "label"), [(1e2, 1e6, "10\N{THIN SPACE}k"), (7.9e4, 8.1e4, "80\N{THIN SPACE}k")]
)
def test_labels_of_a_log_scale_are_plain_text(tmp_path: Path, low_ohm: float, high_ohm: float, label: str) -> None:
    figure, axes = new_figure(1, 3.0)
    axes[0].plot(np.geomspace(low_ohm, high_ohm, 50))
    log_scale(axes[0])
    text = saved(figure, tmp_path, "t", "caption")
    assert f">{label}<" in text
    assert "times" not in text
    assert not any("$" in tick.get_text() for tick in axes[0].get_yticklabels(which="both"))


def test_no_peak_is_lost_among_a_week_of_rows() -> None:
    size = 600_000
    time, steady, other = np.arange(size, dtype=float), np.zeros(size), np.full(size, np.nan)
    steady[[1234, 599_001]] = 5.0, -7.0
    steady[300_000] = np.inf  # beyond the range: no peak, and it hides none
    steady[300_001] = 3.0
    other[400_000:400_200] = 1.0
    t, shown, rest = thinned(time, steady, other)
    assert t.size <= MOST_POINTS
    assert np.all(np.diff(t) > 0.0)
    assert (t[0], t[-1]) == (0.0, size - 1.0)
    assert [float(t[k]) for k in np.flatnonzero(shown != 0.0) if np.isfinite(shown[k])] == [
        1234.0,
        300_001.0,
        599_001.0,
    ]
    assert np.any(rest == 1.0)
    np.testing.assert_array_equal(steady[t.astype(int)], shown)
