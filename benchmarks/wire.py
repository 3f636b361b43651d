"""What a bad cable does to readings: each protocol's driver and emulator on it, in virtual time, by fixed seeds.

    ./peltier benchmark wire [--exchanges 1000000] [--protocol NAME ...] [--json FILE]

An exchange is a reading that is asked for. The thermometer and the film tell their time, so that a number that was not
read between question and answer is wrong. A fifth of the answers, and of the requests, are hurt (TE Technology, with
several questions a reading: a tenth). Three kinds of fault:

disorder    late, split, stale, repeated, glued, lost and foreign replies, lost requests; up to 10 s late, which is
            beyond every time-out and every drain time
seen        the same, and one or two characters in a row changed where a sum or a CRC cannot miss it (MeCom: two; TE
            Technology: one); nothing of the kind is there for SCPI and LDC501: parity is not looked at
any         the same, and bursts of up to three characters, noise that comes in between, missing characters, in both
            directions: what the protocols cannot all see, and the drivers confirm

Target: 0 wrong in each. Further: the share of
changed answers that the frame alone would let pass (summed up in docs/instruments.md), and what confirmation costs.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
from binascii import crc_hqx
from dataclasses import asdict
from itertools import count, product
from pathlib import Path
from typing import Any

from rig.core.clock import VirtualClock
from rig.drivers.scpi_meters import ScpiMeter
from rig.ports import protocol_sim
from tests.rig.drivers.faulty_wire import DISORDER, REPLY_FAULTS, REQUEST_FAULTS, FaultyWire
from tests.rig.drivers.still_plant import StillPlant
from tests.rig.drivers.wire_cases import CONTROLLERS, METERS, Case, Tally, exchange, on_wire

NUMBER = ScpiMeter.NUMBER
CHUNK = 500  # exchanges on one bench; then the next seed
DELAYS_S = (0.05, 0.2, 0.7, 2.0, 5.0, 10.0)
KINDS: dict[str, dict[str, Any]] = {
    "disorder": {"faults": DISORDER, "late_s": DELAYS_S},
    "seen": {"faults": (*DISORDER, "flipped", "request garbled"), "late_s": DELAYS_S},
    "any": {"faults": REPLY_FAULTS + REQUEST_FAULTS, "late_s": DELAYS_S},
}
SEEN_BURST = {"meerstetter": 2, "te_technology": 1}
DIGITS = {"meerstetter": b"0123456789ABCDEF", "te_technology": b"0123456789abcdef"}
BARE = {  # a reading without any proof
    "te_technology": b"*00010000000041\r",
    "te_technology tc-48-20": b"*0161\r",
    "srs_ldc500": b"TTRD?\n",
    "lakeshore": b"CRDG? A\n",
    "tclab": b"T1\n",
    "keithley2000": b":READ?\r",
    "hp34401a": b"READ?\n",
    "keithley2400": b":READ?\r",
    "keithley2450": b":READ?\n",
}


def wrong_readings(case: Case, kind: str, exchanges: int) -> tuple[Tally, list[Any]]:
    """Count chunk after chunk; the first wrong readings are kept."""
    settings, whole, wrong = dict(KINDS[kind]), Tally(), []
    faults = settings.pop("faults")
    if kind == "seen":
        settings["longest_burst"] = SEEN_BURST[case.driver]
    for chunk in count():
        if whole.exchanges >= exchanges:
            break
        tally, found = exchange(case, chunk, faults, CHUNK, **settings)
        whole = Tally(**{name: value + getattr(tally, name) for name, value in asdict(whole).items()})
        wrong += found[: max(0, 20 - len(wrong))]
    return whole, wrong


def frame_passes(driver: str, data: bytes) -> bool:
    """Whether the check of the frame alone lets a frame pass."""
    if driver == "meerstetter":
        return data[-4:] == b"%04X" % crc_hqx(data[:-4], 0)
    return data[-3:-1] == b"%02x" % (sum(data[1:-3]) & 0xFF)


def a_frame(driver: str, chance: random.Random) -> bytes:
    """A reply with a random value."""
    if driver == "meerstetter":
        body = b"!00%04X%08X" % (chance.randrange(1 << 16), chance.randrange(1 << 32))
        return body + b"%04X" % crc_hqx(body, 0)
    body = b"%08x" % (chance.randrange(-10000, 30000) & 0xFFFFFFFF)
    return b"*%b%02x^" % (body, sum(body) & 0xFF)


def passing_share(driver: str, burst: int, count: int) -> float:
    """Of frames with `burst` hexadecimal digits in a row replaced by others: the share that the check lets pass."""
    chance, digits, passed, changed = random.Random(burst), DIGITS[driver], 0, 0
    end = 0 if driver == "meerstetter" else 1
    for _ in range(count):
        frame = a_frame(driver, chance)
        hurt = bytearray(frame)
        begin = chance.randrange(1, len(frame) - end - burst + 1)
        hurt[begin : begin + burst] = bytes(chance.choices(digits, k=burst))
        if hurt != frame:
            changed += 1
            passed += frame_passes(driver, bytes(hurt))
    return passed / changed


def passing_patterns() -> int:
    """Changes of up to three hexadecimal digits in a row that CRC-16 (0x1021) cannot see, of all that there are."""
    digits = DIGITS["meerstetter"]
    changes = sorted({one ^ other for one, other in product(digits, digits)})
    return sum(
        any(change) and crc_hqx(bytes(change) + b"\0\0", 0) == 0  # a multiple of the polynomial
        for change in product(changes, repeat=3)
    )


def confirmed_share(count: int) -> float:
    """Of SCPI and LDC501 answers hurt by two bursts (up to three characters each): the share that is believed, wrong.

    One burst alone cannot be believed: it is shorter than the distance of the two copies.
    """
    chance, believed = random.Random(1), 0
    wire = FaultyWire(None, seed=1, rate=0.0, foreign=b"")  # type: ignore[arg-type]
    for _ in range(count):
        value, token = b"%+.8E" % (chance.uniform(1.0, 9.9) * 1e4), b"%d" % chance.randrange(1, 256)
        first, second, proof = (wire.garble(wire.garble(b";".join((value, value, token)))).split(b";") + [b""] * 3)[:3]
        if first == second != value and proof == token and NUMBER.fullmatch(first.decode("latin-1")):
            believed += 1
    return believed / count


def confirmation_ms(case: Case) -> tuple[float, float]:
    """Time of a reading with its proof, and of a bare question and its answer, on a good wire, ms."""
    clock, name = VirtualClock(), "wire-cost"
    protocol_sim.unregister(name)
    instrument, line = on_wire(lambda end: protocol_sim.register(name, end, clock), clock, case, StillPlant(), 1, ())
    ask = instrument.read if case.meter else instrument.read_temperature
    ask(), ask()  # the range has settled
    begin_s = clock.now_s()
    ask()
    proven_s = clock.now_s() - begin_s
    protocol_sim.unregister(name)
    question = BARE.get(str(case), BARE.get(case.driver, b""))
    if not question:  # nothing is added to a bare question
        return 1e3 * proven_s, 1e3 * proven_s
    begin_s = now_s = clock.now_s() + 1.0
    line.transmit(now_s)
    line.receive(question, now_s)
    while not line.transmit(now_s):
        due_s = line.next_transmit_s()
        now_s = max(now_s + 1e-6, now_s if due_s is None else due_s)
    return 1e3 * proven_s, 1e3 * (now_s - begin_s)


def main() -> None:
    """Count, and print a table."""
    cases = {str(case): case for case in (*CONTROLLERS, *METERS) if "output_between_readings" not in case.options}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--exchanges", type=int, default=1_000_000)
    parser.add_argument("--protocol", action="append", choices=sorted(cases), metavar="NAME", help=", ".join(cases))
    parser.add_argument("--kind", action="append", choices=sorted(KINDS))
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    rows = []
    heads = f"{'exchanges':>10} {'hurt':>9} {'right':>9} {'no number':>9} {'wrong':>6}  hours of wire"
    print(f"{'protocol':24} {'faults':9} {heads}")
    for kind in options.kind or KINDS:
        for name in options.protocol or cases:
            case = cases[name]
            if kind == "seen" and case.driver not in SEEN_BURST:
                continue
            tally, found = wrong_readings(case, kind, options.exchanges)
            print(
                f"{name:24} {kind:9} {tally.exchanges:10} {tally.faults:9} {tally.right:9} {tally.refused:9} "
                f"{tally.wrong:6}  {tally.seconds / 3600.0:.1f}",
                flush=True,
            )
            rows.append({"protocol": name, "faults": kind, **asdict(tally), "found": found})
    shares = {
        f"{driver}: {burst} digits in a row": passing_share(driver, burst, 200_000)
        for driver in DIGITS
        for burst in (1, 2, 3)
    }
    print("\nshare of changed answers that the frame's check lets pass")
    for name, share in shares.items():
        print(f"{name:40} {share:.6f}")
    doubly = confirmed_share(1_000_000)
    print(f"{'SCPI, LDC501: two bursts in one answer':40} {doubly:.6f}")
    patterns = passing_patterns()
    print(f"changes of up to three hexadecimal digits in a row that the CRC cannot see: {patterns}")
    print("\nwhat the proof costs: a reading with it, and a bare question, ms on a good wire")
    costs = {}
    for name in options.protocol or cases:
        costs[name] = confirmation_ms(cases[name])
        print(f"{name:24} {costs[name][0]:8.1f} {costs[name][1]:8.1f}")
    if options.json:
        result = {
            "exchanges": rows,
            "passing_shares": shares,
            "passing_patterns": patterns,
            "confirmed_share": doubly,
            "cost_ms": costs,
        }
        options.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    sys.exit(1 if any(row["wrong"] for row in rows) else 0)


if __name__ == "__main__":
    main()
