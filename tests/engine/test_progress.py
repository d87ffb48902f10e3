"""Progress off a terminal: plain lines, with a time left that a slow first step does not falsify."""

from __future__ import annotations

import io

from pipeline.engine.progress import Progress, clock


def test_time_left_is_measured_after_the_first_step_and_without_resumed_work(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("pipeline.engine.progress.time.monotonic", lambda: now[0])
    stream = io.StringIO()
    with Progress(stream).bar("training", total=100, unit="steps") as bar:
        bar.skip(50)
        now[0] = 60.0  # compiling
        bar.advance()
        assert bar.time_left_s() is None
        now[0] = 70.0
        bar.advance(9)
        assert bar.time_left_s() == 10.0 * 40 / 9
        now[0] = 90.0
        bar.advance(40, extra="PSNR 31.2 dB")
    lines = stream.getvalue().splitlines()
    assert "\r" not in stream.getvalue() and "left" in lines[1] and lines[-1].startswith("training: 100 % (100/100 steps)")


def test_seconds_are_said_as_a_person_does():
    assert [clock(s) for s in (8, 125, 11400)] == ["8 s", "2 min 05 s", "3 h 10 min"]
