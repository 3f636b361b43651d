"""peltier check CONFIG: does what is attached answer, is it what the configuration says, and how long does STOP take.

The output is commanded off first and last; no current flows. Limits and dead man are set and read back.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

from rig.command.record_arguments import add_json_argument
from rig.command.say import Voice

STOPS = 5  # times that switching off is measured


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path)
    add_json_argument(parser)


def main(options: argparse.Namespace) -> int:
    from rig.files.configuration import read_configuration

    voice = Voice(options.json)
    file = read_configuration(options.config)
    from rig.bench import open_bench
    from rig.signals import SignalStop

    with SignalStop(), open_bench(file) as bench:
        for role, identity in bench.identities.items():
            voice.say(f"{role}: {identity}")
        limits = file.content.limits
        controller, meter = bench.controller, bench.meter
        temperature = controller.read_temperature()
        voice.say(f"temperature: {temperature.value:.3f} degC ({temperature.quality})")
        dead_man = f"{file.content.bench.controller.dead_man_s:g} s" if controller.has_dead_man else "none: it has none"
        low, high = limits.temperature_degC
        voice.say(f"limits read back: {limits.current_A:g} A, {low:g} to {high:g} degC; dead man {dead_man}")
        resistance = None
        if meter is not None:
            meter.read_resistance()  # the first one settles the range
            resistance = meter.read_resistance()
            voice.say(
                f"resistance: {resistance.value:.6g} ohm ({resistance.quality}), "
                f"test current {meter.test_current_A:g} A"
            )
        seconds = []
        for _ in range(STOPS):
            begin = time.perf_counter()
            confirmed = controller.off()
            seconds.append(time.perf_counter() - begin)
        voice.say(
            f"STOP: {1e3 * statistics.median(seconds):.1f} ms until the controller confirmed that its output is off"
        )
    voice.say("output off, confirmed by the controller")
    voice.report(
        {
            "format": "peltier-check/1",
            "instruments": {role: str(identity) for role, identity in bench.identities.items()},
            "temperature_degC": temperature.value,
            "resistance_ohm": resistance.value if resistance is not None else None,
            "dead_man": controller.has_dead_man,
            "stop_s": statistics.median(seconds),
            "output_off_confirmed": confirmed,
        }
    )
    return 0
