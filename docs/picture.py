"""Draws docs/picture.svg from a run of the demo:

./peltier run configs/demo.toml --out /tmp/demo && .venv/bin/python docs/picture.py /tmp/demo
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rig.records.record_file import read_record
from rig.report.page import COLOURS, SETTINGS


def tracked(folder: Path) -> dict[str, np.ndarray]:
    record = read_record(folder / "record.csv")
    inside = np.array(record.text_columns["phase"]) == "track"
    columns = {name: values[inside] for name, values in record.columns.items()}
    columns["time_s"] = columns["time_s"] - columns["time_s"][0]
    return columns


def main(folder: Path) -> None:
    full = tracked(folder)
    with mpl.rc_context({**SETTINGS, "font.size": 11}):
        figure = Figure(figsize=(12, 6.2), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=[1.75, 1.0], height_ratios=[1.5, 1.0])
        course, error, loop = (figure.add_subplot(g) for g in (grid[0, 0], grid[1, 0], grid[:, 1]))
        course.semilogy(full["time_s"], full["resistance_ohm"] / 1e3, color=COLOURS["full"], lw=2.4, label="measured")
        course.semilogy(
            full["time_s"], full["target_ohm"] / 1e3, color="#1c2330", lw=1.0, ls=(0, (4, 2)), label="wanted"
        )
        course.set_ylabel("resistance / kΩ")
        course.set_yticks([3, 10, 30], ["3", "10", "30"])
        course.minorticks_off()
        course.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
        course.set_title("a wanted resistance, and the film's", loc="left")
        laws = {"pid": "pid: feedback alone", "feedforward": "feedforward: model alone", "full": "full: both"}
        for name, where in (("pid", "pid"), ("feedforward", "feedforward"), ("full", "")):
            track = tracked(folder / where)
            shown = 1e2 * (track["resistance_ohm"] / track["target_ohm"] - 1.0)
            error.plot(track["time_s"], shown, color=COLOURS[name], label=laws[name], lw=1.6 if name == "full" else 1.1)
        error.set_ylabel("error / %")
        error.set_xlabel("time / s")
        error.legend(loc="upper right", ncols=3, fontsize=9)
        loop.semilogy(full["temperature_degC"], full["resistance_ohm"] / 1e3, color=COLOURS["full"], lw=1.4)
        loop.set_yticks([3, 10, 30], ["3", "10", "30"])
        loop.minorticks_off()
        loop.set_xlabel("temperature / °C")
        loop.set_title("the loops it had to cross", loc="left")
        figure.savefig(Path(__file__).with_name("picture.svg"), metadata={"Date": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
