"""What a PNG says of its codes: chunks cICP and gAMA (PNG specification, third edition, 11.3.2)."""

from __future__ import annotations

import struct
from pathlib import Path

MOST_CHUNKS, SHORT = 100, 32
"""Chunks before the pixels, and bytes of one that may be one of these."""
CICP_LINEAR = 8
"""Transfer characteristics of ITU-T H.273."""
UNIT, NEAR = 100_000, 0.02
"""gAMA is in hundred-thousandths; 1 is linear light."""


def png_states_linear(path: Path) -> bool:
    """Read whether a PNG says that its codes are linear light.

    That they are a display's is no evidence: libraries write chunks that say so (sRGB, a gAMA of 1 / 2.2) into whatever they
    are given.

    Args:
        path: the file; others say nothing.
    """
    try:
        with path.open("rb") as stream:
            if not stream.read(8).startswith(b"\x89PNG"):
                return False
            for _ in range(MOST_CHUNKS):
                length, kind = struct.unpack(">I4s", stream.read(8))
                body = stream.read(min(length, SHORT))
                stream.seek(length - len(body) + 4, 1)
                if kind == b"IDAT":
                    break
                if kind == b"cICP" and len(body) == 4:
                    return body[1] == CICP_LINEAR
                if kind == b"gAMA" and len(body) == 4:
                    return bool(abs(struct.unpack(">I", body)[0] / UNIT - 1) < NEAR)
    except (OSError, struct.error):  # its reader says so
        pass
    return False
