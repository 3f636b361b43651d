"""Draws docs/figures/*.svg, the figures of docs/model.md, docs/paper.md and docs/calibrate_a_film.md.

    .venv/bin/python docs/draw_figures.py
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from compensator.film import IDENTITY, Envelope, FilmModel, Memoryless, Memory
from compensator.inverse import Inverse
from rig.report.figures import COLOURS, SETTINGS

Array = NDArray[np.float64]
OUT = Path(__file__).resolve().parent / "figures"
BLUE, INK, RED, GOLD, GREEN = (COLOURS[name] for name in ("full", "target", "pid", "feedforward", "current"))
PALE, GREY = "#c9d6ea", "#8b94a3"
DEGC, OUTPUT = "temperature / °C", "output  -log10(R / ohm)"
WIDTH = 10.0

FILM = FilmModel(
    radii=[0.05, 0.15, 0.3, 0.5, 0.7],
    weights=[0.25, 0.25, 0.25, 0.2, 0.15],
    rising=Envelope("tanh", 0.17, -10.7),
    falling=Envelope("tanh", 0.17, -10.5),
    memoryless=Memoryless("tanh", amplitude=0.35, a=0.03, b=-1.65, offset=-3.6),
)


def panels(rows: int, columns: int, height: float, **more: Any) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **more)
    return figure, [cast(Axes, axis) for axis in axes.ravel()]


def through(turning: list[float], step: float = 0.05) -> Array:
    """Values through turning points."""
    parts = [np.array(turning[:1], dtype=np.float64)]
    for a, b in zip(turning[:-1], turning[1:], strict=True):
        parts.append(np.linspace(a, b, max(2, round(abs(b - a) / step) + 1))[1:])
    return np.concatenate(parts)


def over(film: FilmModel, turning: list[float], memory: Memory, step: float = 0.05) -> tuple[Array, Array, Memory]:
    """Temperatures through turning points, the output there, and the memory at the end."""
    v = through(turning, step)
    u, after = film.simulate(v, memory)
    return v, u, after


def arrow(axis: Axes, v: Array, u: Array, at: float, colour: str, size: float = 13.0) -> None:
    """An arrow head on a curve at a share of its rows."""
    k = int(at * (v.size - 2))
    m = min(k + max(2, v.size // 40), v.size - 1)
    look = {"arrowstyle": "-|>", "color": colour, "lw": 0.0, "mutation_scale": size, "shrinkA": 0.0, "shrinkB": 0.0}
    axis.annotate("", (v[m], u[m]), (v[k], u[k]), arrowprops=look)


def note(axis: Axes, text: str, at: tuple[float, float], to: tuple[float, float] | None = None, **more: Any) -> None:
    """Text, with a thin line to a point if there is one."""
    style: dict[str, Any] = {"fontsize": 9.5, "color": INK, "ha": "left", "va": "center", **more}
    if to is None:
        axis.text(*at, text, **style)
        return
    axis.annotate(text, to, at, arrowprops={"arrowstyle": "-", "color": GREY, "lw": 0.8}, **style)


def play() -> Figure:
    """One play operator, over time and as a loop; and a generalized one."""
    figure, (time, loop, general) = panels(1, 3, 3.9, width_ratios=[1.25, 1.0, 1.0])
    r = 1.0
    operator = FilmModel([r], [1.0], IDENTITY, IDENTITY, kind="classical_pi")
    v = through([0.0, 3.0, -2.0, 1.4, 0.2, 2.2], 0.01)
    w, _ = operator.simulate(v, Memory(0.0, np.zeros(1)))
    t = np.linspace(0.0, 1.0, v.size)
    time.fill_between(t, v - r, v + r, color=PALE, alpha=0.55, lw=0.0)
    time.plot(t, v, color=RED, label="v, pushed")
    time.plot(t, w, color=BLUE, lw=2.0, label="w, pulled along")
    time.set(xlabel="time", xticks=[], title="w stays within r of v")
    time.legend(loc="lower right", fontsize=9)
    line = np.array([-2.6, 3.6])
    for shift, name in ((-r, "v - r"), (r, "v + r")):
        loop.plot(line, line + shift, color=GREY, lw=0.8, ls=(0, (4, 3)))
        note(loop, name, (3.1, 3.1 + shift), ha="right" if shift > 0 else "left", va="bottom", color=GREY)
    loop.plot(v, w, color=BLUE, lw=1.8)
    arrow(loop, v, w, 0.17, BLUE)
    arrow(loop, v, w, 0.28, BLUE)
    arrow(loop, v, w, 0.43, BLUE)
    loop.set(xlabel="v", ylabel="w", title="classical: radius r", xlim=(-2.8, 4.4), ylim=(-2.2, 4.3))
    rising, falling, radius = Envelope("tanh", 0.16, -9.6), Envelope("tanh", 0.16, -9.4), 0.3
    grid = np.linspace(30.0, 90.0, 400)
    for gamma, name, at in (
        (np.tanh(rising.a * grid + rising.b) - radius, "γ_R(v) - r", (66.0, -0.45)),
        (np.tanh(falling.a * grid + falling.b) + radius, "γ_L(v) + r", (33.0, 0.55)),
    ):
        general.plot(grid, gamma, color=GREY, lw=0.8, ls=(0, (4, 3)))
        note(general, name, at, color=GREY)
    film = FilmModel([radius], [1.0], rising, falling)
    x, y, _ = over(film, [30.0, 68.0, 52.0, 60.0], film.initial_memory(30.0, "heated"))
    general.plot(x, y, color=BLUE, lw=1.8)
    arrow(general, x, y, 0.5, BLUE)
    arrow(general, x, y, 0.68, BLUE)
    arrow(general, x, y, 0.83, BLUE)
    general.set(xlabel=DEGC, title="generalized: envelopes γ")
    return figure


def weighted_sum() -> Figure:
    """What each operator gives, what D gives, and the film that they add up to."""
    figure, (parts, d, whole) = panels(1, 3, 3.9)
    turning = [30.0, 90.0, 30.0]
    start = FILM.initial_memory(30.0, "heated")
    v = through(turning)
    plays = FILM.play_outputs(v, start)
    colours = ["#1f5fbf", "#4d7fcc", "#7b9fd9", "#a3bce4", "#c2d2ec"]
    for k, colour in enumerate(colours):
        parts.plot(v, plays[:, k] * FILM.weights[k], color=colour, label=f"r = {FILM.radii[k]:g}")
    parts.set(xlabel=DEGC, title="p_j w_j: small radii, thin loops")
    parts.legend(loc="lower right", fontsize=8.5)
    slow = 0.35 * np.tanh(0.03 * v - 1.65) - 3.6
    d.plot(v, slow, color=GOLD, lw=1.8)
    d.set(xlabel=DEGC, title="D(v): no loop, no saturation", ylim=(-4.6, -2.6))
    whole.plot(v, FILM.simulate(v, start)[0], color=INK, lw=1.8)
    whole.set(xlabel=DEGC, ylabel=OUTPUT, title="u = D(v) + Σ p_j w_j")
    return figure


def memory() -> Figure:
    """Minor loops, and what is forgotten when one closes."""
    figure, (loop, plays) = panels(1, 2, 4.4, width_ratios=[1.25, 1.0])
    v, u, after = over(FILM, [30.0, 90.0, 30.0], FILM.initial_memory(30.0, "heated"))
    loop.plot(v, u, color=PALE, lw=1.6)
    turning = [30.0, 64.0, 58.0, 62.5]
    v, u, deep = over(FILM, turning, after)
    loop.plot(v, u, color=BLUE, lw=1.8)
    for k, place in enumerate(turning[1:], start=1):
        point = over(FILM, turning[: k + 1], after)[1][-1]
        loop.plot(place, point, "o", color=BLUE, ms=5.0)
        left = k == 2
        note(loop, "ABC"[k - 1], (place + (-1.0 if left else 0.8), point), fontweight="bold", ha="right" if left else "left")
    v, u, _ = over(FILM, [62.5, 64.0, 74.0], deep)
    loop.plot(v, u, color=RED, lw=1.8, ls=(0, (5, 2)))
    note(loop, "on past A: as if B and C had never been", (65.2, -3.95), (65.5, u[v > 65.5][0]), color=RED)
    loop.set(xlabel=DEGC, ylabel=OUTPUT, title="a loop that closes is wiped out", xlim=(50.0, 78.0))
    states = [
        ("at A", over(FILM, [30.0, 64.0], after)[2], BLUE),
        ("at B", over(FILM, [30.0, 64.0, 58.0], after)[2], GOLD),
        ("at C", deep, GREEN),
        ("at A again", FILM.simulate([63.0, 64.0], deep)[1], RED),
    ]
    for name, state, colour in states:
        again = name == "at A again"
        plays.plot(
            FILM.radii,
            state.plays,
            "x" if again else "o-",
            color=colour,
            label=name,
            ms=9.0 if again else 5.0,
            mew=1.8,
            zorder=3 if again else 2,
        )
    plays.set(xlabel="radius r_j", ylabel="w_j", title="all of the memory: one number an operator")
    plays.legend(loc="upper right", fontsize=9)
    return figure


def relays(v: Array, spread_K: float, seed: int = 4) -> Array:
    """Output of a film of 3,000 relays, first all down, whose width grows with its mean temperature."""
    rng = np.random.default_rng(seed)
    mean = rng.normal(61.0, 3.2, 3000)
    half = 2.6 * np.exp(0.3 * rng.normal(size=3000)) * np.exp(spread_K * (mean - 61.0))
    state, out = np.zeros(3000, dtype=bool), np.empty(v.size)
    for k, x in enumerate(v):
        state |= x > mean + half
        state &= x >= mean - half
        out[k] = state.mean()
    return 2.0 * out - 4.2


def congruency() -> Figure:
    """Two loops between the same temperatures; and a loop's width along the transition, common and mixed envelopes."""
    figure, (same, wide) = panels(1, 2, 4.2)
    low, high = 59.0, 65.0
    v, u, cold = over(FILM, [30.0, 90.0, 30.0], FILM.initial_memory(30.0, "heated"))
    same.plot(v, u, color=PALE, lw=1.6)
    hot = over(FILM, [30.0, 90.0], cold)[2]
    for state, first, colour, name in ((cold, 30.0, RED, "reached by heating"), (hot, 90.0, BLUE, "by cooling")):
        begun = over(FILM, [first, low if first > 60.0 else high], state)[2]
        ends = [low, high, low] if first > 60.0 else [high, low, high]
        v, u, _ = over(FILM, ends, begun)
        same.plot(v, u, color=colour, lw=1.8, label=name)
    same.set(xlabel=DEGC, ylabel=OUTPUT, title="same end temperatures, same loop", xlim=(50.0, 76.0))
    same.legend(loc="upper left", fontsize=9)
    v = through([30.0, 90.0, 30.0], 0.1)
    half = v.size // 2
    grid = np.linspace(-4.0, -2.4, 60)
    for growth, colour, name in ((0.0, BLUE, "one width everywhere"), (0.12, GOLD, "wider where it is hotter")):
        u = relays(v, growth)
        width = np.interp(grid, u[: half + 1], v[: half + 1]) - np.interp(grid, u[half:][::-1], v[half:][::-1])
        wide.plot(width, grid, color=colour, lw=1.8, label=name)
    grid_film = np.linspace(-4.2, -2.9, 60)
    mixed = FilmModel(
        radii=[0.3, 0.3],
        weights=[0.5, 0.5],
        rising=(Envelope("tanh", 0.30, -17.6), Envelope("tanh", 0.30, -20.6)),
        falling=(Envelope("tanh", 0.30, -17.2), Envelope("tanh", 0.30, -18.6)),
        memoryless=Memoryless("linear", amplitude=0.004, offset=-3.75),
        kind="mixed_envelopes",
    )
    u, _ = mixed.simulate(v, mixed.initial_memory(30.0, "heated"))
    width = np.interp(grid_film, u[: half + 1], v[: half + 1]) - np.interp(grid_film, u[half:][::-1], v[half:][::-1])
    wide.plot(width, grid_film, color=RED, lw=1.4, ls=(0, (5, 2)), label="two operators, own envelopes")
    wide.set(xlabel="width of the major loop / K", ylabel=OUTPUT, title="why mixed envelopes", xlim=(0.0, 12.0))
    wide.legend(loc="lower right", fontsize=9)
    return figure


def inverse() -> Figure:
    """The two branches from a memory, the reachable interval, and solving on one."""
    figure, (both, solve) = panels(1, 2, 4.4)
    v, u, after = over(FILM, [30.0, 90.0, 30.0], FILM.initial_memory(30.0, "heated"))
    both.plot(v, u, color=PALE, lw=1.6)
    state = over(FILM, [30.0, 66.0, 60.0], after)[2]
    low, high = 52.0, 78.0
    here = FILM.output_at(state)
    up_v, up, _ = over(FILM, [60.0, high], state)
    down_v, down, _ = over(FILM, [60.0, low], state)
    both.axhspan(float(down[-1]), float(up[-1]), color="#eef2f8", lw=0.0)
    both.plot(up_v, up, color=RED, lw=2.0, label="heat: the rising branch")
    both.plot(down_v, down, color=BLUE, lw=2.0, label="cool: the falling branch")
    both.plot(60.0, here, "o", color=INK, ms=6.0)
    note(both, "now", (60.3, here - 0.12))
    target = -3.25
    solution = Inverse(FILM, low, high).solve(target, state)
    both.plot([49.0, solution.temperature_degC], [target, target], color=INK, lw=0.9, ls=(0, (4, 3)))
    both.plot(2 * [solution.temperature_degC], [-4.4, target], color=INK, lw=0.9, ls=(0, (4, 3)))
    note(both, "wanted", (49.2, target + 0.07), va="bottom")
    note(both, "reachable\nwithout turning", (80.5, 0.5 * (float(down[-1]) + float(up[-1]))), color=GREY)
    both.set(xlabel=DEGC, ylabel=OUTPUT, title="from here, one curve each way", xlim=(49.0, 90.0), ylim=(-4.4, -2.7))
    both.legend(loc="upper left", fontsize=9, bbox_to_anchor=(0.0, 0.97))
    x = np.linspace(60.0, 70.0, 400)
    y = np.array([FILM.step(float(each), state)[0] for each in x])
    solve.plot(x, y - target, color=RED, lw=2.0)
    solve.axhline(0.0, color=INK, lw=0.9, ls=(0, (4, 3)))
    a, b = 60.0, 70.0
    for k, trial in enumerate(bracket(state, target, a, b)):
        solve.plot(trial, FILM.step(trial, state)[0] - target, "o", color=INK, ms=5.0)
        if k < 3:
            solve.text(trial + 0.2, FILM.step(trial, state)[0] - target - 0.07, f"{k + 1}", fontsize=9.5)
    solve.plot(solution.temperature_degC, 0.0, "o", mfc="white", mec=BLUE, ms=9.0, mew=1.8)
    solve.set(xlabel=DEGC, ylabel="model - wanted", title="one unknown, one bracket: solved", xlim=(59.5, 70.5))
    return figure


def bracket(state: Memory, target: float, a: float, b: float) -> list[float]:
    """Trials of a safeguarded secant between a and b."""
    f_a, f_b = (FILM.step(x, state)[0] - target for x in (a, b))
    trials = []
    for _ in range(4):
        trial = a - f_a * (b - a) / (f_b - f_a)
        f = FILM.step(trial, state)[0] - target
        trials.append(trial)
        if f < 0.0:
            a, f_a = trial, f
        else:
            b, f_b = trial, f
    return trials


def order() -> Figure:
    """The jump of the paper's table 2 at a reversal, and the fixed point in a dead band."""
    figure, (jump, bounce) = panels(1, 2, 4.2)
    radii = np.arange(1, 31) / 30.0
    weights = np.exp(-radii / 0.4)
    table_2 = FilmModel(
        radii,
        1.04 * weights / weights.sum(),
        Envelope("tanh", 0.20, -11.6),
        Envelope("tanh", 0.16, -10.3),
        Memoryless("tanh", 0.4, 0.03, -1.6, -3.26),
    )
    start = table_2.initial_memory(30.0, "heated")
    for turn, colour in ((56.0, GOLD), (61.0, RED), (66.0, BLUE)):
        v, u, _ = over(table_2, [30.0, turn, turn - 9.0], start)
        jump.plot(v, u, color=colour, lw=1.6)
        here = over(table_2, [30.0, turn], start)[1][-1]
        jump.plot(turn, here, "o", color=colour, ms=5.0)
    jump.set(xlabel=DEGC, ylabel=OUTPUT, title="table 2, extended: a jump at every reversal", xlim=(44.0, 72.0))
    note(jump, "turned round here", (48.5, -2.75), (60.8, over(table_2, [30.0, 61.0], start)[1][-1]))
    film = FilmModel(
        np.arange(15) / 15.0,
        np.full(15, 1.0 / 15.0),
        Envelope("tanh", 0.15, -9.6),
        Envelope("tanh", 0.15, -9.0),
        Memoryless("linear", 0.004),
    )
    state = over(film, [30.0, 64.0], film.initial_memory(30.0, "heated"))[2]
    target = film.step(62.5, state)[0]
    d = 0.004
    course = [64.0]
    for _ in range(7):
        play_part = target - d * course[-1]
        course.append(branch(film, state, play_part))
    bounce.plot(range(len(course)), course, "o-", color=RED, lw=1.4, ms=5.0, label="fixed point, eq (20)")
    bounce.axhline(62.5, color=BLUE, lw=1.6, label="the solution")
    bounce.set(xlabel="iteration", ylabel=DEGC, title="a target inside a dead band: it never converges", ylim=(58.0, 66.5))
    bounce.legend(loc="upper right", fontsize=9, ncols=2)
    return figure


def branch(film: FilmModel, state: Memory, y: float) -> float:
    """Psi^-1: where the play part has the value y, on the rising branch if y is above the present one, else falling."""
    plain = FilmModel(film.radii, film.weights, film.rising, film.falling)
    edge = Memory(state.input_degC, state.plays)
    return Inverse(plain, 0.0, 150.0).solve(y, edge).temperature_degC


def faults() -> Figure:
    """The major loop at two rates, with a lagging thermometer and with self-heating, as a calibration would see it."""
    figure, axes = panels(1, 3, 4.0, sharey=True)
    start = FILM.initial_memory(30.0, "heated")
    for axis, title in zip(
        axes,
        ("as it should be", "thermometer lags by 4 s", "test current heats the film"),
        strict=True,
    ):
        for rate, colour in ((0.1, BLUE), (0.6, RED)):
            plate = through([30.0, 90.0, 30.0], 0.25 * rate)
            film = plate.copy()
            shown = plate.copy()
            if title.startswith("thermometer"):
                for k in range(1, plate.size):
                    shown[k] = shown[k - 1] + (plate[k] - shown[k - 1]) * 0.25 / 4.0
            if title.startswith("test"):
                heated, state = np.empty(plate.size), start
                now = -4.2
                for k, each in enumerate(plate):
                    heated[k] = each + 400.0 * (5e-4) ** 2 * 10.0**-now
                    now, state = FILM.step(float(heated[k]), state)
                film = heated
            u, _ = FILM.simulate(film, start)
            if rate > 0.1 or not title.startswith("test"):
                axis.semilogy(shown, 10.0**-u / 1e3, color=colour, lw=1.5, label=f"{rate:g} K/s")
        if title.startswith("test"):
            u, _ = FILM.simulate(through([30.0, 90.0, 30.0], 0.05), start)
            axis.clear()
            plate = through([30.0, 90.0, 30.0], 0.05)
            for current, colour in ((1e-4, BLUE), (5e-4, RED)):
                heated, state, now = np.empty(plate.size), start, -4.2
                for k, each in enumerate(plate):
                    heated[k] = each + 400.0 * current**2 * 10.0**-now
                    now, state = FILM.step(float(heated[k]), state)
                axis.semilogy(plate, 10.0 ** -FILM.simulate(heated, start)[0] / 1e3, color=colour, lw=1.5)
                axis.lines[-1].set_label(f"{1e3 * current:g} mA")
        axis.set(xlabel="temperature shown / °C", xlim=(48.0, 78.0), title=title)
        axis.set_yticks([1, 3, 10], ["1", "3", "10"])
        axis.minorticks_off()
        axis.legend(loc="upper right", fontsize=9)
    axes[0].set_ylabel("resistance / kΩ")
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "play": play,
    "sum": weighted_sum,
    "memory": memory,
    "congruency": congruency,
    "inverse": inverse,
    "order": order,
    "faults": faults,
}


def main() -> None:
    OUT.mkdir(exist_ok=True)
    style = {**SETTINGS, "axes.titlelocation": "left", "axes.titlesize": 10.5}
    with mpl.rc_context(cast(Any, style)):
        for name, draw in FIGURES.items():
            draw().savefig(OUT / f"{name}.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
