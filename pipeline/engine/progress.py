"""Progress of long work: a live bar with time left on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

PLAIN_INTERVAL_S = 10.0  # a line now and then keeps logs readable and still shows life


class Bar:
    """One piece of work of known length; `advance` it as parts are done."""

    def __init__(self, title: str, total: float, unit: str, stream: TextIO) -> None:
        """Start a bar.

        Args:
            title: of the work.
            total: its length in `unit`.
            unit: such as "views".
            stream: where the bar is shown.
        """
        self.title, self.total, self.unit, self.stream = title, max(total, 1e-9), unit, stream
        self.done, self.extra = 0.0, ""
        self.first_done: float | None = None  # work of an earlier leg says nothing about this leg's speed
        self.started = self.spoken = self.measured_from = time.monotonic()

    def advance(self, amount: float = 1, extra: str = "") -> None:
        """Count `amount` units as done; `extra` is shown beside the bar (a loss, a PSNR)."""
        self.done += amount
        if self.first_done is None:  # the first unit may have paid for compilation: speed is measured from here on
            self.first_done, self.measured_from = self.done, time.monotonic()
        self.extra = extra or self.extra
        self._show()

    def skip(self, amount: float) -> None:
        """Count units that an earlier, interrupted leg has done."""
        self.done += amount

    def time_left_s(self) -> float | None:
        """Seconds left at the speed since the first advance; None before the second."""
        done_here = self.done - self.first_done if self.first_done is not None else 0.0
        if done_here <= 0:
            return None
        return (time.monotonic() - self.measured_from) * max(self.total - self.done, 0.0) / done_here

    def _line(self) -> str:
        left = self.time_left_s()
        tail = "" if left is None or self.done >= self.total else f", {clock(left)} left"
        extra = f", {self.extra}" if self.extra else ""
        share = min(100.0, 100 * self.done / self.total)
        return f"{self.title}: {share:3.0f} % ({self.done:g}/{self.total:g} {self.unit}){tail}{extra}"

    def _show(self) -> None:
        if time.monotonic() - self.spoken >= PLAIN_INTERVAL_S:
            self.spoken = time.monotonic()
            print(self._line(), file=self.stream, flush=True)

    def close(self) -> None:
        """Say how it ended, where it took long enough to be worth a line."""
        spent = time.monotonic() - self.started
        if spent >= PLAIN_INTERVAL_S:
            print(f"{self._line()} in {clock(spent)}", file=self.stream, flush=True)


class TerminalBar(Bar):
    """The same bar, redrawn in place on a terminal."""

    REDRAW_S = 0.1

    def _show(self) -> None:
        if time.monotonic() - self.spoken >= self.REDRAW_S or self.done >= self.total:
            self.spoken = time.monotonic()
            width = 24
            filled = int(width * min(1.0, self.done / self.total))
            bar = "━" * filled + "╌" * (width - filled)
            print(f"\r\x1b[2K  {bar} {self._line()}", end="", file=self.stream, flush=True)

    def close(self) -> None:
        print("\r\x1b[2K", end="", file=self.stream, flush=True)


def clock(seconds: float) -> str:
    """Write a time as a person says it: 8 s, 2 min 05 s, 3 h 10 min.

    Args:
        seconds: >= 0.

    Returns:
        The words.
    """
    s = round(seconds)
    if s < 60:
        return f"{s} s"
    return f"{s // 60} min {s % 60:02d} s" if s < 3600 else f"{s // 3600} h {s % 3600 // 60:02d} min"


def brief(seconds: float) -> str:
    """Say seconds as `clock` does, with a digit after the point below ten.

    Args:
        seconds: of time.

    Returns:
        The words.
    """
    return f"{seconds:.1f} s" if seconds < 9.95 else clock(seconds)


class Progress:
    """Where a stage reports how far it is."""

    def __init__(self, stream: TextIO | None = None, quiet: bool = False) -> None:
        """Choose where progress is shown.

        Args:
            stream: a terminal gets live bars, anything else plain lines; None: stderr.
            quiet: show nothing.
        """
        self.stream = stream or sys.stderr
        self.quiet = quiet

    @contextmanager
    def bar(self, title: str, total: float, unit: str = "") -> Iterator[Bar]:
        """A bar over `total` units; closes itself."""
        kind = TerminalBar if self.stream.isatty() and not self.quiet else Bar
        bar = kind(title, total, unit, self.stream)
        if self.quiet:
            bar.spoken = float("inf")
        try:
            yield bar
        finally:
            if not self.quiet:
                bar.close()

    def say(self, text: str) -> None:
        """One line of plain news."""
        if not self.quiet:
            print(f"  {text}", file=self.stream, flush=True)
