"""Draws docs/figures/*.svg, the figures of docs/model.md, paper.md, calibrate_a_film.md and python.md.

.venv/bin/python docs/draw_figures.py [NAME ...]
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from contextlib import chdir
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from compensator.hysteresis.film import IDENTITY, Envelope, FilmModel, Memory, Memoryless
from compensator.inverse.inverse import Inverse
from rig.report.page import COLOURS, SETTINGS
from sim.inference.film.fit import identify_film

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
    for a, b in pairwise(turning):
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
    for shift, name, at in ((-r, "v - r", (3.5, 2.0)), (r, "v + r", (0.9, 3.3))):
        loop.plot(line, line + shift, color=GREY, lw=0.8, ls=(0, (4, 3)))
        note(loop, name, at, color=GREY)
    loop.plot(v, w, color=BLUE, lw=1.8)
    arrow(loop, v, w, 0.17, BLUE)
    arrow(loop, v, w, 0.28, BLUE)
    arrow(loop, v, w, 0.43, BLUE)
    loop.set(xlabel="v", ylabel="w", title="classical: radius r", xlim=(-2.8, 4.4), ylim=(-2.2, 4.3))
    rising, falling, radius = Envelope("tanh", 0.16, -9.6), Envelope("tanh", 0.16, -9.4), 0.3
    grid = np.linspace(30.0, 90.0, 400)
    for gamma, name, at in (
        (np.tanh(rising.a * grid + rising.b) - radius, "γR(v) - r", (66.0, -0.45)),
        (np.tanh(falling.a * grid + falling.b) + radius, "γL(v) + r", (38.0, 0.85)),
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
    parts.set(xlabel=DEGC, title="each operator: weight × w")
    parts.legend(loc="lower right", fontsize=8.5)
    slow = 0.35 * np.tanh(0.03 * v - 1.65) - 3.6
    d.plot(v, slow, color=GOLD, lw=1.8)
    d.set(xlabel=DEGC, title="D(v): no loop, no saturation", ylim=(-4.7, -2.45))
    whole.plot(v, FILM.simulate(v, start)[0], color=INK, lw=1.8)
    whole.set(xlabel=DEGC, ylabel=OUTPUT, title="the film: D(v) + their sum", ylim=(-4.7, -2.45))
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
        note(
            loop,
            "ABC"[k - 1],
            (place + (-1.0 if left else 0.8), point),
            fontweight="bold",
            ha="right" if left else "left",
        )
    v, u, _ = over(FILM, [62.5, 64.0, 74.0], deep)
    loop.plot(v, u, color=RED, lw=1.8, ls=(0, (5, 2)))
    note(loop, "on past A: as if B\nand C had never been", (67.2, -3.75), (65.7, u[v > 65.7][0]), color=RED)
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
    plays.set(
        xlabel="radius r of the operator", ylabel="its output w", title="all of the memory: one number an operator"
    )
    plays.legend(loc="upper right", fontsize=9)
    return figure


class Relays:
    """A film of 3,000 relays, first all down; relays are wider the hotter their mean temperature is."""

    def __init__(self, seed: int = 4) -> None:
        rng = np.random.default_rng(seed)
        mean = rng.normal(61.0, 3.2, 3000)
        half = 2.6 * np.exp(0.3 * rng.normal(size=3000) + 0.12 * (mean - 61.0))
        self.up, self.down = mean + half, mean - half
        self.state = np.zeros(3000, dtype=bool)

    def __call__(self, v: Array) -> Array:
        out = np.empty(v.size)
        for k, x in enumerate(v):
            self.state |= x > self.up
            self.state &= x >= self.down
            out[k] = self.state.mean()
        return 2.0 * out - 4.2


def openings(film: Callable[[Array], Array], centres: Array) -> Array:
    """How far minor loops of 8 K, entered from the cold end, are open in their middle (decades)."""
    found = []
    for centre in centres:
        v = through([30.0, centre + 4.0, centre - 4.0, centre + 4.0], 0.1)
        u = film(v)
        last = u[-161:]  # 80 steps down, 80 up
        found.append(float(last[40] - last[120]))
    return np.array(found)


def congruency() -> Figure:
    """Two loops between the same temperatures; how open minor loops are, with one pair of envelopes and a density."""
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
    turns = list(np.random.default_rng(2).uniform(48.0, 74.0, 24))
    v = through([30.0, 85.0, 30.0, 75.0, 50.0, 70.0, 54.0, 66.0, 58.0, *turns, 30.0], 0.25)
    u, centres = Relays()(v), np.linspace(48.0, 74.0, 53)
    wide.plot(centres, openings(lambda x: Relays()(x), centres), color=BLUE, lw=3.0, label="film of relays")
    for kind, colour, name in (
        ("extended_generalized_pi", GOLD, "one pair of envelopes"),
        ("mixed_envelopes", RED, "with a Preisach density"),
    ):
        time_s = np.arange(v.size, dtype=np.float64)
        film = identify_film(time_s, v, u, kind=kind, initial="heated", temperature_noise_K=0.0).model  # type: ignore[arg-type]
        shown = openings(lambda x, film=film: film.simulate(x, film.initial_memory(float(x[0]), "heated"))[0], centres)
        wide.plot(centres, shown, color=colour, lw=1.6, ls=(0, (5, 2)), label=name)
    wide.set(xlabel="middle of a minor loop of 8 K / °C", ylabel="how far it is open / dec")
    wide.set_title("how open minor loops are along the transition")
    wide.legend(loc="upper right", fontsize=9)
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
    both.plot(2 * [solution.temperature_degC], [-4.5, target], color=INK, lw=0.9, ls=(0, (4, 3)))
    note(both, "wanted", (49.2, target + 0.07), va="bottom")
    note(both, "reachable\nwithout turning", (88.0, 0.5 * (float(down[-1]) + float(up[-1]))), color=GREY, ha="right")
    both.set(xlabel=DEGC, ylabel=OUTPUT, title="from here, one curve each way", xlim=(49.0, 90.0), ylim=(-4.5, -2.2))
    both.legend(loc="upper left", fontsize=9)
    x = np.linspace(60.0, 70.0, 400)
    y = np.array([FILM.step(float(each), state)[0] for each in x])
    solve.plot(x, y - target, color=RED, lw=2.0)
    solve.axhline(0.0, color=INK, lw=0.9, ls=(0, (4, 3)))
    a, b = 60.0, 70.0
    for k, trial in enumerate(bracket(state, target, a, b)):
        solve.plot(trial, FILM.step(trial, state)[0] - target, "o", color=INK, ms=5.0)
        if k < 2:
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
    bounce.set(
        xlabel="iteration", ylabel=DEGC, title="a target inside a dead band: it never converges", ylim=(58.0, 66.5)
    )
    bounce.legend(loc="upper right", fontsize=9, ncols=2)
    return figure


def branch(film: FilmModel, state: Memory, y: float) -> float:
    """Psi^-1: where the play part has the value y, on the rising branch if y is above the present one, else falling."""
    plain = FilmModel(film.radii, film.weights, film.rising, film.falling)
    edge = Memory(state.input_degC, state.plays)
    return Inverse(plain, 0.0, 150.0).solve(y, edge).temperature_degC


def lagged(values: Array, steps: float) -> Array:
    """A first-order lag with a time constant of so many rows."""
    out = values.copy()
    for k in range(1, values.size):
        out[k] = out[k - 1] + (values[k] - out[k - 1]) / steps
    return out


def heated_by(plate: Array, current_A: float, start: Memory, K_per_W: float = 400.0) -> Array:
    """Temperatures of a film that the meter's test current heats."""
    film, state, now = np.empty(plate.size), start, FILM.output_at(start)
    for k, each in enumerate(plate):
        film[k] = each + K_per_W * current_A**2 * 10.0**-now
        now, state = FILM.step(float(film[k]), state)
    return film


def faults() -> Figure:
    """The major loop at two rates or test currents: sound, and with three things that go wrong."""
    figure, axes = panels(1, 4, 3.7, sharey=True)
    start, tau_s, row_s = FILM.initial_memory(30.0, "heated"), 3.0, 0.25
    titles = ("sound", "thermometer lags 3 s", "film lags 3 s", "test current heats")
    for axis, title in zip(axes, titles, strict=True):
        for fast, colour in ((False, BLUE), (True, RED)):
            rate = 0.6 if fast else 0.1
            plate = through([30.0, 90.0, 30.0], row_s * rate)
            film, shown, label = plate, plate, f"{rate:g} K/s"
            if title.startswith("thermometer"):
                shown = lagged(plate, tau_s / row_s)
            elif title.startswith("film"):
                film = lagged(plate, tau_s / row_s)
            elif title.startswith("test"):
                current_A = 5e-4 if fast else 1e-4
                film, label = heated_by(plate, current_A, start), f"{1e3 * current_A:g} mA"
            axis.semilogy(shown, 10.0 ** -FILM.simulate(film, start)[0] / 1e3, color=colour, lw=1.5, label=label)
        axis.set(xlabel="shown / °C", xlim=(50.0, 76.0), title=title)
        axis.set_yticks([1, 3, 10], ["1", "3", "10"])
        axis.minorticks_off()
        axis.legend(loc="upper right", fontsize=9)
    axes[0].set_ylabel("resistance / kΩ")
    return figure


def notebook() -> Figure:
    """What the blocks of docs/python.md draw, in a folder of their own."""
    text, names = (OUT.parent / "python.md").read_text(encoding="utf-8"), {"__name__": "page"}
    with TemporaryDirectory() as folder, chdir(folder):
        for block in re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
            exec(block, names)
    return cast(Figure, names["figure"])


FIGURES: dict[str, Callable[[], Figure]] = {
    "play": play,
    "sum": weighted_sum,
    "memory": memory,
    "congruency": congruency,
    "inverse": inverse,
    "order": order,
    "faults": faults,
    "notebook": notebook,
}


def main() -> None:
    OUT.mkdir(exist_ok=True)
    style = {**SETTINGS, "axes.titlelocation": "left", "axes.titlesize": 10.5}
    with mpl.rc_context(cast(Any, style)):
        for name in sys.argv[1:] or FIGURES:
            FIGURES[name]().savefig(OUT / f"{name}.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
