"""The bench's metrics for Prometheus, computed when it asks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

STATES = ("idle", "running", "stopped", "tripped", "offline")
GAUGES = {
    "temperature_degC": ("peltier_temperature_celsius", "Thermometer's reading."),
    "resistance_ohm": ("peltier_resistance_ohms", "Ohmmeter's reading."),
    "current_A": ("peltier_current_amperes", "Current commanded; positive heats. Of a heater its drive, 0 to 1."),
    "setpoint_degC": ("peltier_setpoint_celsius", "Wanted temperature."),
    "target_ohm": ("peltier_target_ohms", "Wanted resistance."),
}


class Metrics:
    """A registry with one collector."""

    def __init__(self) -> None:
        self._registry = CollectorRegistry(auto_describe=False)
        self._registry.register(self)
        self._given: tuple[dict[str, Any], dict[str, Any], int, bool] = ({}, {}, 0, True)

    def text(self, state: dict[str, Any], row: dict[str, Any], rows: int, gone: bool) -> tuple[bytes, str]:
        """Return the text and its media type, from the last state and row."""
        self._given = (state, row, rows, gone)
        return generate_latest(self._registry), CONTENT_TYPE_LATEST

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics, for the registry."""
        state, row, rows, gone = self._given
        up = GaugeMetricFamily("peltier_up", "1 if the bench process answers.")
        up.add_metric([], 0.0 if gone else 1.0)
        yield up
        word = GaugeMetricFamily("peltier_state", "1 for the state that the bench is in.", labels=["state"])
        for name in STATES:
            word.add_metric([name], float(state.get("state") == name))
        yield word
        reading = {**state.get("reading", {}), **row}
        for column, (name, text) in GAUGES.items():
            value = reading.get(column)
            yield _gauge(name, text, math.nan if value is None else float(value))
        yield _gauge("peltier_output_on", "1 on, 0 off, NaN unknown.", _output(state))
        yield _gauge("peltier_output_confirmed", "1 if the controller confirmed it.", state.get("output_confirmed"))
        yield _gauge("peltier_jobs_queued", "Jobs that wait.", state.get("queue"))
        yield _gauge("peltier_viewers", "Pages that are open.", state.get("viewers"))
        yield _gauge("peltier_warnings", "Warnings that are shown.", len(state.get("warnings", [])))
        yield _gauge("peltier_cycle_age_seconds", "Since the last control cycle.", state.get("cycle_age_s"))
        yield _gauge("peltier_tick_latest_seconds", "Largest lateness.", state.get("ticks", {}).get("latest_s"))
        for key, text in (("done", "Control cycles completed."), ("missed", "Control cycles missed.")):
            counter = CounterMetricFamily(f"peltier_ticks_{key}", text)
            counter.add_metric([], float(state.get("ticks", {}).get(key, 0)))
            yield counter
        counter = CounterMetricFamily("peltier_rows_published", "Rows committed and published.")
        counter.add_metric([], float(rows))
        yield counter


def _output(state: dict[str, Any]) -> float:
    return {"on": 1.0, "off": 0.0}.get(state.get("output", "unknown"), math.nan)


def _gauge(name: str, text: str, value: Any) -> GaugeMetricFamily:
    gauge = GaugeMetricFamily(name, text)
    gauge.add_metric([], math.nan if value is None else float(value))
    return gauge
