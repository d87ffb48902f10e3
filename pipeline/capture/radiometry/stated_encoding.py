"""What headers say of how codes encode light: ICC profiles, EXIF's colour space, and kinds of files that differ."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.capture.naming.files import some

MOST_TAGS = 100
CURVES = (b"rTRC", b"gTRC", b"kTRC")
EXIF_SPACES = {1: "sRGB", 2: "Adobe RGB"}
STRAIGHT = 0.02
"""How far the middle of a table may lie off a straight line, of its end; the curve of sRGB lies 0.29 below."""
FULL_SCALE = {"int8": 127, "int16": 32767, "int": 2**31 - 1, "uint": 2**32 - 1}
"""Of samples, as OpenImageIO calls them."""
KINDS = {0: "float", 8: "8 bits", 16: "16 bits", 32: "32 bits"}


def stated_curve(spec: Any) -> str | None:
    """The words of an open image's header (OpenImageIO) for codes that are no linear light; None where it says nothing."""
    profile = spec.getattribute("ICCProfile")
    if profile is not None:
        data = bytes(bytearray(int(b) & 0xFF for b in profile))
        name = str(spec.getattribute("ICCProfile:profile_description") or "ICC").strip()
        return f"the colour profile {name!r}" if profile_is_curved(data) else None
    space = spec.get_int_attribute("Exif:ColorSpace", 0)
    return f"EXIF's colour space {EXIF_SPACES[space]}" if space in EXIF_SPACES else None


def profile_is_curved(profile: bytes) -> bool:
    """Whether an ICC profile's tone curve (ICC.1:2010, 10.5, 10.15) is no straight line; False where it has none."""
    try:
        (number,) = struct.unpack_from(">I", profile, 128)
        rows = [profile[132 + 12 * k : 144 + 12 * k] for k in range(min(number, MOST_TAGS))]
        tags = {row[:4]: int(struct.unpack(">I", row[4:8])[0]) for row in rows}
        at = next((tags[name] for name in CURVES if name in tags), None)
        if at is None:
            return False
        if profile[at : at + 4] == b"para":
            kind, gamma = struct.unpack_from(">HxxI", profile, at + 8)
            return kind != 0 or gamma != 1 << 16
        (count,) = struct.unpack_from(">I", profile, at + 8)
        if count == 1:
            return bool(struct.unpack_from(">H", profile, at + 12)[0] != 256)
        if count < 3:
            return False
        middle, last = (struct.unpack_from(">H", profile, at + 12 + 2 * k)[0] for k in (count // 2, count - 1))
        return abs(middle / max(last, 1) - (count // 2) / (count - 1)) > STRAIGHT
    except struct.error:
        return False


def stated_words(curves: Mapping[Path, str]) -> list[str]:
    """A warning where 16-bit files, which are read as linear light, say that they are not (`curves`: of those that do)."""
    if not curves:
        return []
    first = next(iter(curves))
    return [
        f"{first}{_others(len(curves))}: {curves[first]} is of a display, but 16-bit files are read as linear light: "
        'export them linear, or say so in capture.toml: radiometry.encoding = "srgb" (or "linear", if the header is wrong)'
    ]


def integer_words(formats: Mapping[Path, str]) -> list[str]:
    """A warning where files hold integers that no camera writes as they are (`formats`: the samples' types, as "int32")."""
    odd = {path: kind for path, kind in formats.items() if kind in FULL_SCALE}
    if not odd:
        return []
    first, kind = next(iter(odd.items()))
    return [
        f"{first}{_others(len(odd))}: holds {kind} samples, which are read as parts of {FULL_SCALE[kind]}: a sensor's codes "
        "are hardly any light then; export 16-bit (uint16) or float files"
    ]


def linear_words(paths: Sequence[Path]) -> list[str]:
    """A warning where 8-bit files, which are read as sRGB, state that they are linear light."""
    if not paths:
        return []
    return [
        f"{paths[0]}{_others(len(paths))}: states linear light, but 8-bit files are read as sRGB: export 16 bits, or "
        'say so in capture.toml: radiometry.encoding = "linear" (or "srgb", if the header is wrong)'
    ]


def unstated_words(first: Path, evidence: str | None) -> tuple[list[str], list[str]]:
    """(warnings, facts) where 16-bit pictures say nothing of how they are coded. evidence: by what they look coded."""
    say = 'say radiometry.encoding = "srgb" in capture.toml'
    if evidence is None:
        return [], [f"16-bit files are read as linear light: if a converter or viewer wrote them for a display, {say}"]
    return [
        f"{first}: these 16-bit files {evidence}, and are read as linear light: export them linear, or {say} "
        '("linear", if they are)'
    ], []


def mixed_words(bits: Mapping[Path, int]) -> list[str]:
    """A warning where some files are of 8 bits, read as sRGB, and others are read as linear light. bits: 0 is float."""
    kinds = Counter(bits.values())
    if len(kinds) < 2 or 8 not in kinds:
        return []
    listed = ", ".join(f"{n} of {KINDS.get(b, b)}" for b, n in sorted(kinds.items()))
    odd = min(kinds, key=lambda b: (kinds[b], b))
    named = some(p.name for p, b in bits.items() if b == odd)
    where = next(p.parent for p, b in bits.items() if b == odd)
    return [
        f"{where}: files of several kinds ({listed}; {named}): those of 8 bits are read as sRGB, the others as linear light, "
        "each on a scale of its own; check that they are one set, and export all alike"
    ]


def _others(count: int) -> str:
    return f" and {count - 1} more" if count > 1 else ""
