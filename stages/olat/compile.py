"""Compile the fits for this machine ahead of the first run: python -m stages.olat.compile (`make setup` does)."""

from __future__ import annotations

from .pixel_fit.many_pixels import load
from .reading.zip_frames import unpack_kernel


def main() -> None:
    """Compile what frames of half floats need; any other kind is compiled when it is first met."""
    unpack_kernel()
    load(half=True, precision="float32")


if __name__ == "__main__":
    main()
