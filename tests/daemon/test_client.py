"""What a verb that talks to a daemon leaves behind with --json."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from rig.daemon.client import write_json
from tests.rig.small import no_file_above


@pytest.mark.skipif(not hasattr(signal, "SIGXFSZ"), reason="file sizes are limited on POSIX only")
def test_an_answer_that_does_not_fit_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    target = tmp_path / "status.json"
    write_json(str(target), {"output": "off"})
    before = target.read_text()
    assert before == '{\n  "output": "off"\n}\n'
    with no_file_above(4096), pytest.raises(OSError, match=r"status\.json"):
        write_json(str(target), {"warnings": ["x" * 100_000]})
    assert target.read_text() == before
    assert list(tmp_path.iterdir()) == [target]
