"""A simulated hour at 10 Hz, the bytes of both instruments included: how long it takes. Asked: 10 s.

    ./peltier benchmark simulated_hour

The film is the demo's Preisach film; the full law tracks a slow sine. Reading, law, interlock, row: all of it.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path

from benchmarks._harness import ROOT
from rig.__main__ import main as peltier


def main() -> int:
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        demo = (ROOT / "configs" / "demo.toml").read_text()
        head, rest = demo.split("target = [", 1)
        after = rest.split("]\n", 1)[1]
        short = 'target = ["start 50 kohm", "hold 10 s"]\n'
        (folder / "first.toml").write_text(head.replace('compare = ["pid", "feedforward"]', "") + short + after)
        peltier(["run", str(folder / "first.toml"), "--out", str(folder / "first")])
        hour = 'model = "first/calibration/MODEL.toml"\n'
        hour += 'target = ["start 50 kohm", "ramp to 20 kohm in 60 s", "sine 0.3 dec period 120 s for 3540 s"]\n'
        text = head.replace('compare = ["pid", "feedforward"]', "") + hour + after
        (folder / "hour.toml").write_text(text)
        begin = time.perf_counter()
        peltier(["run", str(folder / "hour.toml"), "--out", str(folder / "hour")])
        seconds = time.perf_counter() - begin
        document = json.loads((folder / "hour" / "run.json").read_text())
        rows = document["stop"]["rows"]
        print(f"{rows} ticks of 0.1 s with report in {seconds:.1f} s: {seconds / rows * 36000:.1f} s an hour; asked 10")
    return 0


if __name__ == "__main__":
    sys.exit(main())
