"""The paper's figures 3 to 8 and its models of tables 1 and 2, drawn from the studies, with what was chosen below."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks._paper_models import Array, damped_oscillation, table_1, table_2
from benchmarks._paper_studies import Compensation, Fits, Iterations
from compensator.hysteresis.film import FilmModel
from rig.report.figures import COLOURS, SETTINGS

FILM, EXTENDED, GENERALIZED, INK = COLOURS["measured"], COLOURS["model"], COLOURS["feedforward"], COLOURS["target"]
STAND_IN = (
    "Chosen: the film (4,000 relays, means N(61, 3.2) °C, half-widths lognormal with median 2.8 K and sigma 0.4, two "
    "decades, plus 0.35 tanh(0.03 (T - 55))); no noise. "
)
DEGC = "temperature / °C"


def draw(out: Path, found: Fits, classical: Iterations, five: Compensation) -> list[Path]:
    """Every figure as SVG and PNG in `out`."""
    out.mkdir(parents=True, exist_ok=True)
    written = []
    with mpl.rc_context(cast(Any, SETTINGS)):
        figures = {
            "tables_1_2": _tables(),
            "figure_3": _figure_3(found),
            "figure_4": _figure_4(found),
            "figure_5": _figure_5(found),
            "figure_6": _figure_6(classical),
            "figure_7": _figure_7(classical),
            "figure_8": _figure_8(five),
        }
        for name, figure in figures.items():
            for kind in ("svg", "png"):
                written.append(out / f"{name}.{kind}")
                figure.savefig(written[-1], metadata={"Date": None} if kind == "svg" else None, dpi=130)
    return written


def _panels(rows: int, columns: int, height: float, caption: str, share_x: bool = False) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(10.0, height), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=share_x)
    figure.supxlabel(textwrap.fill(caption, 140), x=0.01, ha="left", fontsize=8.5, color="#566070")
    return figure, [cast(Axes, each) for each in axes.ravel()]


def _tables() -> Figure:
    figure, axes = _panels(
        2,
        2,
        8.2,
        "Models of tables 1 and 2 over damped oscillations. Fixed by the text: envelopes, D, numbers of operators and "
        "radii. Chosen: all weights (falling as exp(-r/0.4), scaled to 1,500 1/m and to two decades) and the profile. "
        "The steps at reversals are the model's own: the smaller radii violate the order condition below eq (6).",
    )
    cases: list[tuple[FilmModel, str, str]] = [
        (table_1(False), "table 1, generalized", "curvature / (1/m)"),
        (table_1(True), "table 1, extended: D = 40.1 sin(0.17 v) + c", "curvature / (1/m)"),
        (table_2(False), "table 2, generalized", "-log10(R / ohm)"),
        (table_2(True), "table 2, extended: D = 0.4 tanh(0.03 v - 1.6) + c", "-log10(R / ohm)"),
    ]
    for k, (axis, (film, title, unit)) in enumerate(zip(axes, cases, strict=True)):
        curvature = k < 2
        v = damped_oscillation(*((80.0, 20.0, 50.0) if curvature else (90.0, 30.0, 62.0)), 6, 0.1)
        u = film.simulate(v, film.initial_memory(float(v[0]), "cooled"))[0]
        axis.plot(v, u, color=EXTENDED if k % 2 else GENERALIZED, linewidth=1.1)
        axis.set_title(title, loc="left", fontsize=10)
        axis.set_xlabel(DEGC)
        axis.set_ylabel(unit)
    return figure


def _figure_3(found: Fits) -> Figure:
    caption = (
        STAND_IN + "Chosen: the profile (ten damped cycles, 90 to 30 °C). Fixed: at most 30 operators, tanh envelopes, "
        "tanh D. Weights, radii and parameters were fitted by `identify`."
    )
    figure, axes = _panels(1, 2, 4.6, caption)
    for axis, name, colour in zip(axes, ("generalized", "extended"), (GENERALIZED, EXTENDED), strict=True):
        axis.plot(found.profile, found.output, color=FILM, linewidth=1.6, label="film")
        error = found.errors(name)
        axis.plot(found.profile, found.fitted[name], color=colour, linewidth=0.9, label=f"{name} model")
        axis.set_title(f"RMSE {error[0]:.4f} dec, largest {error[1]:.3f} dec", loc="left", fontsize=10)
        axis.set_xlabel(DEGC)
        axis.legend(loc="lower right")
    axes[0].set_ylabel("-log10(R / ohm)")
    return figure


def _figure_4(found: Fits) -> Figure:
    figure, axes = _panels(
        1, 2, 3.8, STAND_IN + "Chosen: the random sequence (40 turning points between 45 and 80 °C)."
    )
    axes[0].plot(found.random, color=COLOURS["temperature"], linewidth=1.0)
    axes[0].set_xlabel("sample")
    axes[0].set_ylabel(DEGC)
    axes[1].plot(found.random, found.random_output, color=FILM, linewidth=0.9)
    axes[1].set_xlabel(DEGC)
    axes[1].set_ylabel("-log10(R / ohm)")
    return figure


def _figure_5(found: Fits) -> Figure:
    caption = STAND_IN + "Models fitted to the profile of figure 3, predicting the random sequence of figure 4."
    figure, axes = _panels(1, 1, 3.6, caption)
    for name, colour in (("generalized", GENERALIZED), ("extended", EXTENDED), ("default", INK)):
        error = found.predicted[name] - found.random_output
        label = f"{name}{' of this program: Preisach density' if name == 'default' else ''}, RMSE {_rms(error):.4f} dec"
        axes[0].plot(error, color=colour, linewidth=1.0, label=label)
    axes[0].set_xlabel("sample")
    axes[0].set_ylabel("model - film / dec")
    axes[0].set_ylim(top=0.13)
    axes[0].legend(loc="upper left", ncols=3, fontsize=8.5)
    return figure


CLASSICAL = (
    "Fixed by the text: classical play operators, p(r0) = 6, D = 5 cos v. Chosen: radii 0, 1, .. 5, the other "
    "weights 3 exp(-r/2), the input (24 random turning points in -10 to 10, steps of 0.25), memory at rest at 0. "
)


def _figure_6(classical: Iterations) -> Figure:
    figure, axes = _panels(1, 2, 4.0, CLASSICAL)
    axes[0].plot(classical.inputs, color=INK, linewidth=1.0)
    axes[0].set_xlabel("sample")
    axes[0].set_ylabel("input v")
    axes[1].plot(classical.inputs, classical.outputs, color=FILM, linewidth=0.9)
    axes[1].set_xlabel("input v")
    axes[1].set_ylabel("output u")
    return figure


def _figure_7(classical: Iterations) -> Figure:
    caption = CLASSICAL + "The inverse by fixed-point iteration, sigma = 1e-4, and the model's output at what it gave."
    figure, axes = _panels(1, 2, 4.2, caption)
    v = classical.found[1e-4]
    axes[0].plot(classical.outputs, v, color=EXTENDED, linewidth=0.9)
    axes[0].set_xlabel("wanted output")
    axes[0].set_ylabel("v of the inverse")
    axes[1].plot(classical.outputs, classical.got, color=FILM, linewidth=1.2)
    axes[1].set_xlabel("wanted output")
    axes[1].set_ylabel("output")
    axes[1].set_title(
        f"largest difference {np.max(np.abs(classical.got - classical.outputs)):.1e}", loc="left", size=10
    )
    return figure


def _figure_8(five: Compensation) -> Figure:
    caption = (
        STAND_IN
        + "Five operators, compressed from the extended model of figure 3; open loop. Chosen: the wanted course "
        "(triangles between 200 ohm and 20 kohm). The paper's 0.135 is from a measured film."
    )
    figure, axes = _panels(2, 1, 5.4, caption, share_x=True)
    axes[0].plot(five.got, color=FILM, linewidth=1.6, label="film")
    axes[0].plot(five.wanted, color=INK, linewidth=1.0, linestyle=(0, (4, 2)), label="wanted")
    axes[0].set_ylabel("-log10(R / ohm)")
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    axes[1].plot(five.error, color=EXTENDED, linewidth=1.0)
    for level in (-0.135, 0.135):
        axes[1].axhline(level, color="#8b94a3", linewidth=0.8, linestyle=(0, (2, 3)))
    axes[1].set_ylabel("error / dec")
    axes[1].set_xlabel("sample  (dotted: the paper's largest error)")
    return figure


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
