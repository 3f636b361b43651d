"""A record diagnosed: which effects it is likely to have, and what they leave over."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from compensator.thermal.plate import Kind
from sim.effects.catalogue import catalogue
from sim.effects.effect import Effect
from sim.findings.search import Search, left_over
from sim.findings.starts import base_fit
from sim.inference.joint import Fit, TwoChannels


@dataclass(frozen=True, eq=False)
class Selected:
    """The likeliest set: base and extended fit, what is left over by channel, effects that are read off directly."""

    base: Fit
    fit: Fit
    left: dict[str, float]
    extra: list[str]
    search: Search


def selected(
    record: TwoChannels,
    effects: Sequence[Effect] | None = None,
    kind: Kind = "peltier",
    say: Callable[[str], None] = lambda text: None,
) -> Selected:
    """Select the effects of a record. effects: those that are possible; None: the catalogue."""
    search = Search(list(catalogue().values()) if effects is None else effects, say)
    base = base_fit(record, kind)
    fit = search.run(base)
    return Selected(base, fit, left_over(fit), _rounded(fit), search)


def _rounded(fit: Fit) -> list[str]:
    """Whether the thermometer's readings are rounded more coarsely than half of their noise."""
    step = fit.joint.record.step_K
    return ["thermometer_quantization"] if step > 0.5 * fit.metric.temperature.noise.white and step > 0.0 else []
