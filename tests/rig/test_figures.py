"""What figures say beside their lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rig.report.figures import log_scale, new_figure, saved


@pytest.mark.parametrize(
    ("low_ohm", "high_ohm", "label"), [(1e2, 1e6, "10\N{THIN SPACE}k"), (7.9e4, 8.1e4, "80\N{THIN SPACE}k")]
)
def test_labels_of_a_log_scale_are_plain_text(tmp_path: Path, low_ohm: float, high_ohm: float, label: str) -> None:
    figure, axes = new_figure(1, 3.0)
    axes[0].plot(np.geomspace(low_ohm, high_ohm, 50))
    log_scale(axes[0])
    text = saved(figure, tmp_path, "t")
    assert f">{label}<" in text
    assert "times" not in text
    assert not any("$" in tick.get_text() for tick in axes[0].get_yticklabels(which="both"))
