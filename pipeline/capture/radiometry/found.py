"""What a capture's files tell of their radiometry beyond capture.toml: exposures, white level, encoding."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.angle_stack.solve import polariser_design
from pipeline.capture.config import CaptureConfig, RadiometryConfig
from pipeline.capture.naming.files import RAW_SUFFIXES, count, some
from pipeline.capture.naming.grouping import Exposure, Group
from pipeline.capture.radiometry.code_range import some_of
from pipeline.capture.radiometry.curve_in_codes import curve_in_codes
from pipeline.capture.radiometry.encoding import find_encoding, impossible_share, mosaic_codes, stack_codes
from pipeline.capture.radiometry.exposure import HeaderExposure, even_out, exposure_of, read_exposure
from pipeline.capture.radiometry.of_file import FoundRadiometry, factor_of
from pipeline.capture.radiometry.stated_encoding import (
    integer_words,
    linear_words,
    mixed_words,
    stated_curve,
    stated_words,
    unstated_words,
)
from pipeline.capture.radiometry.white_level import codes_of, white_level
from pipeline.errors import UserError
from pipeline.formats.images import open_image, srgb_decode
from pipeline.formats.png_curve import png_states_linear

if TYPE_CHECKING:
    from pipeline.capture.pixels.linear_image import LinearImage


@dataclass(frozen=True)
class Understood:
    """The capture's settings with what was found in its files, and words for the user."""

    config: CaptureConfig
    facts: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Header:
    bits: int
    exposure: HeaderExposure
    curve: str | None = None
    linear: bool = False
    kind: str = ""


def understand(groups: Sequence[Group], config: CaptureConfig, kind: str, bayer: bool = False) -> Understood:
    """Look at the files of views for what capture.toml leaves open: exposures, white level, encoding.

    Args:
        groups: the views' files.
        config: capture.toml.
        kind: "stack", "mosaic" or "colour".
        bayer: the sensor has a colour mosaic.

    Returns:
        The configuration with what was found, and facts and warnings about it.

    Raises:
        UserError: a file cannot be read.
    """
    radiometry = config.radiometry
    single = {e.path: e for g in groups for es in g.angles.values() if len(es) == 1 for e in es}
    headers = {path: _header(e) for path, e in single.items()}
    known = {path: header.exposure for path, header in headers.items()}
    exposures = even_out(known, radiometry, lambda path: brightness(single[path], config, kind))
    own = {f.name: getattr(radiometry, f.name) for f in fields(RadiometryConfig)}
    settled = radiometry.factors if isinstance(radiometry, FoundRadiometry) else {}  # by all folders together
    found = FoundRadiometry(**own, factors=exposures.factors or settled)
    facts, warnings = [*exposures.facts], [*exposures.warnings]
    files = [(e.path, e) for g in groups for es in g.angles.values() for e in es if e.path.suffix.lower() not in RAW_SUFFIXES]
    headers |= {p: _header(e) for p, e in files if p not in headers}
    bits = {headers[p].bits for p, _ in files}
    linear = bits == {16} and radiometry.encoding != "srgb"
    open_ = None in (radiometry.white_level, radiometry.encoding)
    codes = codes_of([e for _, e in files]) if linear and open_ else []
    if linear and radiometry.white_level is None:
        white, words, remarks = white_level([e for _, e in files], codes)
        found = found if white is None else replace(found, white_level=white)
        warnings += words
        facts += remarks
    if radiometry.white_level is None:
        warnings += integer_words({p: headers[p].kind for p, _ in files})
    if radiometry.encoding is None and kind != "mosaic":
        words, remarks = _of_encoding(headers, [p for p, _ in files], codes, kind)
        warnings += words
        facts += remarks
    if radiometry.encoding is None and bits and bits <= {8, 16} and kind in ("stack", "mosaic"):
        encodings, words = _encodings(groups, replace(config, radiometry=found), kind, bayer, bits == {8})
        found = replace(found, encodings=encodings)
        warnings += words
    if not (found.factors or found.encodings) and found.white_level == radiometry.white_level:
        return Understood(config, tuple(facts), tuple(warnings))
    return Understood(replace(config, radiometry=found), tuple(facts), tuple(warnings))


def _of_encoding(
    headers: Mapping[Path, _Header], files: Sequence[Path], codes: Sequence[NDArray[np.uint16]], kind: str
) -> tuple[list[str], list[str]]:
    """(warnings, facts) of how codes stand for light, from what headers say, and 16-bit `codes` where these say nothing."""
    said = mixed_words({p: headers[p].bits for p in files})
    stated = {p: h.curve for p, h in headers.items() if h.curve and h.bits == 16}
    if kind == "colour":
        said += linear_words([p for p, h in headers.items() if h.linear and h.bits == 8])
    if stated or kind != "colour" or not codes:
        return said + stated_words(stated), []
    words, facts = unstated_words(files[0], curve_in_codes(codes))
    return said + words, facts


def _header(exposure: Exposure) -> _Header:
    path = exposure.path
    if path.suffix.lower() in RAW_SUFFIXES:
        return _Header(0, read_exposure(path))
    image = open_image(path, exposure.page)
    spec = image.spec()
    image.close()
    linear = path.suffix.lower() == ".png" and png_states_linear(path)
    bits = {"uint8": 8, "uint16": 16}.get(str(spec.format), 0)
    return _Header(bits, exposure_of(spec), stated_curve(spec), linear, str(spec.format))


def brightness(exposure: Exposure, config: CaptureConfig, kind: str) -> NDArray[np.float64] | None:
    """Percentiles of a picture's linear light; None where it cannot be read (its reader says why)."""
    from pipeline.capture.pixels.linear import read_linear

    try:
        pixels = read_linear(exposure.path, config.radiometry, kind == "mosaic", exposure.page).pixels
    except UserError:
        return None
    step = max(1, min(pixels.shape[:2]) // 512)
    light = pixels[::step, ::step, :3].mean(-1, dtype=np.float64)
    light = light[np.isfinite(light)]
    return np.percentile(light, (10, 25, 50, 75, 90)) if light.size else None


def _is_raw(group: Group) -> bool:
    return any(path.suffix.lower() in RAW_SUFFIXES for path in group.paths)


def _encodings(
    groups: Sequence[Group], config: CaptureConfig, kind: str, bayer: bool, eight: bool
) -> tuple[dict[Path, str], list[str]]:
    """Encodings by file where the angles tell another one than the usual, with the word for it."""
    usable = [g for g in groups if all(len(es) == 1 for es in g.angles.values()) and not _is_raw(g)]
    if not usable:
        return {}, []
    usual = "srgb" if eight and kind == "stack" else "linear"
    size = open_image(usable[0].paths[0], next(iter(usable[0].angles.values()))[0].page)
    each = size.spec().width * size.spec().height * size.spec().nchannels * len(usable[0].angles)
    size.close()
    samples = {g.view: _codes_of(g, config, kind, bayer) for g in some_of(usable, each)}
    known = {view: _encoding_of(found, usual) for view, found in samples.items()}
    other = "linear" if usual == "srgb" else "srgb"
    if usual not in known.values() and other not in known.values() and _together(list(samples.values()), usual) == other:
        known = dict.fromkeys(known, other)  # what no file tells alone
    if set(known.values()) <= {None, usual}:
        return {}, []
    if usual in known.values():  # not alike: each file that says so clearly
        known |= {g.view: _encoding_of(_codes_of(g, config, kind, bayer), usual) for g in usable if g.view not in known}
        chosen = [g for g in usable if known[g.view] == other]
    else:
        chosen = list(groups)
    encodings = {p: other for g in chosen for p in g.paths}
    words = {"srgb": "sRGB", "linear": "linear light"}
    whole = len(chosen) == len(groups)
    which = "these files" if whole else count(chosen, "of these files") if kind == "mosaic" else count(chosen, "of these views")
    named = "" if whole else f" ({some(g.view for g in chosen)})"
    line = (
        f"{chosen[0].paths[0]}: the codes of {which}{named} keep the law of polarisers (I0 + I90 = I45 + I135, DoLP at most 1) "
        f"as {words[other]} and not as {words[usual]}: read as {words[other]}; "
        + (f'say so in capture.toml: radiometry.encoding = "{other}"' if whole
           else f'keep them in a capture of their own, with radiometry.encoding = "{other}" in its capture.toml')
    )  # fmt: skip
    return encodings, [line]


_Codes = tuple[NDArray[np.float32], NDArray[np.float64]]


def _codes_of(group: Group, config: CaptureConfig, kind: str, bayer: bool) -> _Codes | None:
    """One view's codes [n, P] and the design [n, 3] behind them; None where they cannot be read (their reader says why)."""
    plain = replace(config.radiometry, encoding="linear", dark_frame=None, flat_field=None, factors={}, encodings={})  # type: ignore[call-arg]
    try:
        images = [_some_rows(es[0], plain) for es in group.angles.values()]
        if kind == "mosaic":
            design = polariser_design(config.mosaic.order)
            codes = mosaic_codes(images[0].pixels[..., 0], bayer)
        else:
            design = polariser_design([a for a in group.angles if a is not None])
            colours = [image.rgb(es[0].path) for image, es in zip(images, group.angles.values())]
            if len({c.shape for c in colours}) > 1:
                return None
            codes = stack_codes(colours)
            design = design / np.array([[factor_of(config.radiometry, es[0].path)] for es in group.angles.values()])
    except UserError:
        return None
    return codes, design


def _together(samples: Sequence[_Codes | None], usual: str) -> str | None:
    """What the codes of several views behind one design tell together."""
    there = [found for found in samples if found is not None]
    if len(there) < 2 or any(not np.array_equal(design, there[0][1]) for _, design in there):
        return None
    return _encoding_of((np.concatenate([codes for codes, _ in there], 1), there[0][1]), usual)


def _encoding_of(found: _Codes | None, usual: str) -> str | None:
    """What codes tell; None where they do not."""
    if found is None:
        return None
    codes, design = found
    finding = find_encoding(codes, design)
    if finding is not None and finding.encoding is not None:
        return finding.encoding
    if usual == "srgb":
        as_srgb = impossible_share(srgb_decode(codes), design)
        if as_srgb > POSSIBLE and impossible_share(codes, design) < 0.1 * as_srgb:
            return "linear"
    return None


def _some_rows(exposure: Exposure, radiometry: RadiometryConfig) -> LinearImage:
    """A picture's samples, of large ones bands of rows from top to bottom. Raises UserError."""
    from pipeline.capture.pixels.linear_image import LinearImage
    from pipeline.capture.pixels.row_bands import ROWS, LinearReader

    reader = LinearReader(exposure.path, radiometry, True, exposure.page)
    width, height = reader.size
    starts = list(range(0, height, ROWS))
    if width * height > LARGE:
        starts = sorted({int(k) for k in np.linspace(0, len(starts) - 2, BANDS)})
        starts = [k * ROWS for k in starts]
    parts = []
    try:
        for start in starts:
            stop = min(start + ROWS, height)
            pixels = np.empty((stop - start, width, len(reader.names)), np.float32)
            reader.fill(start, stop, pixels, np.empty(pixels.shape[:2], bool))
            parts.append(pixels)
    finally:
        reader.close()
    pixels = np.concatenate(parts)
    return LinearImage(pixels, reader.names, np.zeros(pixels.shape[:2], bool), reader.bits)


LARGE, BANDS = 1 << 20, 8
"""Pixels above which bands of rows are looked at, and how many."""
POSSIBLE = 0.02
"""Share of lit places that noise and edges may drive beyond a degree of polarisation of 1 (decode warns at 0.01 of all)."""
