"""Files that hold several images (TIFF pages, EXR parts and layers): which of them is meant, or a fault that says so.

A file with more than one image is never read as its first one without a word: one image is chosen by what the images are
called, parts S0 S1 S2 are put together, and whatever stays open is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError

MAY_HOLD_SEVERAL = frozenset({".exr", ".tif", ".tiff", ".gif", ".webp", ".npy", ".raw"})
MAIN = frozenset({"", "rgba", "rgb", "combined", "beauty", "color", "colour", "image", "main", "composite"})
"""What programs call the picture itself among its layers or parts."""
REDUCED_OR_MASK = 1 | 4
"""Bits of TIFF's NewSubfileType: a smaller copy, a transparency mask."""
SPLIT = "save one image a file"


@dataclass(frozen=True)
class Page:
    """One image of a file that holds several.

    Fields:
        subimage: its number in the file, from 0.
        channels: numbers of those of its channels that are meant.
        names: what those channels are called.
        title: what the file calls the image; "" where it does not.
    """

    subimage: int
    channels: tuple[int, ...]
    names: tuple[str, ...]
    title: str = ""


class PartsInput:
    """The part of OpenImageIO's ImageInput that our readers use, over chosen pages that make one image together."""

    def __init__(self, image: Any, pages: Sequence[Page]) -> None:
        """`image` stays open until close(). The pages have one size."""
        import OpenImageIO as oiio

        self._image, self._pages = image, list(pages)
        self._whole: dict[tuple[int, str], NDArray[Any]] = {}
        image.seek_subimage(pages[0].subimage, 0)
        first = image.spec()
        names = tuple(name for page in pages for name in page.names)
        self._spec = oiio.ImageSpec(first)
        self._spec.nchannels = len(names)
        self._spec.channelnames = names
        self._spec.channelformats = ()
        self._spec.alpha_channel = names.index("A") if "A" in names else -1
        self._spec.tile_width = self._spec.tile_height = self._spec.tile_depth = 0

    def spec(self) -> Any:
        """The header of the image that the pages make."""
        return self._spec

    def read_image(self, kind: str) -> NDArray[Any] | None:
        """All pixels [H, W, C]; None where the file is damaged."""
        return self.read_scanlines(0, 0, self._spec.y, self._spec.y + self._spec.height, 0, 0, self._spec.nchannels, kind)

    def read_scanlines(
        self, subimage: int, level: int, top: int, bottom: int, z: int, first: int, last: int, kind: str
    ) -> NDArray[Any] | None:
        """Rows [top, bottom) [rows, W, C], all channels; None where the file is damaged."""
        bands = []
        for page in self._pages:
            band = self._rows(page, top, bottom, kind)
            if band is None:
                return None
            bands.append(band[..., list(page.channels)])
        return np.concatenate(bands, -1)[..., first:last]

    def _rows(self, page: Page, top: int, bottom: int, kind: str) -> NDArray[Any] | None:
        self._image.seek_subimage(page.subimage, 0)
        spec = self._image.spec()
        if not spec.tile_width:
            pixels = self._image.read_scanlines(page.subimage, 0, top, bottom, 0, 0, spec.nchannels, kind)
            return None if pixels is None else np.asarray(pixels).reshape(bottom - top, spec.width, -1)
        if (page.subimage, kind) not in self._whole:
            pixels = self._image.read_image(page.subimage, 0, 0, spec.nchannels, kind)
            if pixels is None:
                return None
            self._whole[page.subimage, kind] = np.asarray(pixels).reshape(spec.height, spec.width, -1)
        whole: NDArray[Any] = self._whole[page.subimage, kind]
        return whole[top - spec.y : bottom - spec.y]

    def geterror(self) -> str:
        """What went wrong last."""
        return str(self._image.geterror())

    def close(self) -> bool:
        """Let go of the file."""
        return bool(self._image.close())


def chosen(image: Any, path: Path, page: Page | None = None, plain: bool = False) -> Any:
    """`image` (an open ImageInput at its first subimage) itself where it holds one image, else a PartsInput of the `page` asked
    for, or of what its parts mean. `plain`: the layer that is the picture goes by R, G, B. Raises UserError where that is open.
    """
    if page is not None:
        return PartsInput(image, [page])
    pages = pages_of(image, path)
    if len(pages) == 1:
        names = plain_names(pages[0].names, path) if plain else pages[0].names
        if names == pages[0].names and pages[0].subimage == 0:
            image.seek_subimage(0, 0)
            return image
        return PartsInput(image, [Page(pages[0].subimage, pages[0].channels, names)])
    return PartsInput(image, _meant(pages, path) if path.suffix.lower() == ".exr" else _refused(pages, path))


def pages_of(image: Any, path: Path) -> list[Page]:
    """List the images of an open file; a TIFF's thumbnails and transparency masks are none.

    Args:
        image: an open image (OpenImageIO's, or an array file's); left at its first subimage.
        path: the file, for its suffix.

    Returns:
        One page an image, each with all its channels.
    """
    pages: list[Page] = []
    several = path.suffix.lower() in MAY_HOLD_SEVERAL and hasattr(image, "seek_subimage")
    k = 0
    while k == 0 or (several and image.seek_subimage(k, 0)):
        spec = image.spec()
        names = tuple(spec.channelnames)
        title = str(spec.getattribute("oiio:subimagename") or spec.getattribute("tiff:PageName") or "")
        if k == 0 or not int(spec.getattribute("tiff:subfiletype") or 0) & REDUCED_OR_MASK:
            pages.append(Page(k, tuple(range(len(names))), names, title))
        if path.suffix.lower() == ".exr" and k + 1 >= int(spec.getattribute("oiio:subimages") or 1):
            break
        k += 1
    if several and k:
        image.geterror()  # asking for one more than there are is no fault of the file
        image.seek_subimage(0, 0)
    return pages


def layers(names: Sequence[str]) -> dict[str, dict[str, int]]:
    """Sort channels into layers: the layer is what stands before a name's last dot.

    Args:
        names: channels in file order.

    Returns:
        Layer ("" where a name has no dot) to its channels: name within the layer to number in the file.
    """
    out: dict[str, dict[str, int]] = {}
    for i, name in enumerate(names):
        layer, _, channel = name.rpartition(".")
        out.setdefault(layer, {})[channel] = i
    return out


def without_alpha(names: Sequence[str]) -> list[int]:
    """Pick the channels that hold light.

    Args:
        names: channels in file order.

    Returns:
        Numbers of all channels but A.
    """
    return [i for i, name in enumerate(names) if name.lower() != "a"]


def _colour_layers(names: Sequence[str]) -> list[str]:
    """The layers with R, G and B."""
    return [layer for layer, inside in layers(names).items() if {"r", "g", "b"} <= {c.lower() for c in inside}]


def _main_of(titles: Sequence[str]) -> list[int]:
    """Which of these is the picture itself: the only one, or the only one that is called so."""
    if len(titles) == 1:
        return [0]
    return [i for i, title in enumerate(titles) if title.lower().replace("/", ".").rpartition(".")[2] in MAIN]


def plain_names(names: tuple[str, ...], path: Path) -> tuple[str, ...]:
    """The names of one part's channels without the prefix of the layer that is its picture. Raises UserError."""
    lower = [name.lower() for name in names]
    if path.suffix.lower() != ".exr" or {"r", "g", "b"} <= set(lower) or not any("." in name for name in names):
        return names
    if (prefix := _stokes_prefix(lower)) is not None:
        return tuple(name[len(prefix) :] if name.lower().startswith(prefix) else name for name in names)
    coloured = _colour_layers(names)
    if not coloured:
        return names
    main = _main_of(coloured)
    if len(main) != 1:
        raise UserError(path, f"holds {len(coloured)} coloured layers ({', '.join(coloured[:6])})", f"{SPLIT}, as R, G, B")
    prefix = coloured[main[0]] + "."
    return tuple(name[len(prefix) :] if name.startswith(prefix) else name for name in names)


def _stokes_prefix(lower: Sequence[str]) -> str | None:
    """What stands before S0, S1, S2 (in colour or grey) in the names of all three, or None; "" where nothing does."""
    for first in ("s0.r", "s0.y", "s0"):
        for name in lower:
            before = name[: -len(first)]
            if name.endswith(first) and (not before or before.endswith(".")):
                others = (first.replace("s0", f"s{k}") for k in (1, 2))
                if all(before + other in lower for other in others):
                    return before
    return None


def _meant(pages: list[Page], path: Path) -> list[Page]:
    """The pages of a multi-part EXR that make the picture. Raises UserError."""
    together = [_qualified(page) for page in pages]
    every = [name.lower() for page in together for name in page.names]
    prefix = _stokes_prefix(every)
    if prefix is not None:
        own = [
            (page, [i for i, n in enumerate(page.names) if n.lower().startswith(prefix)])
            for page in together
        ]  # fmt: skip
        return [
            Page(p.subimage, tuple(p.channels[i] for i in inside), tuple(p.names[i][len(prefix) :] for i in inside))
            for p, inside in own
            if inside and any(p.names[i][len(prefix) :].lower().startswith(("s0", "s1", "s2")) for i in inside)
        ]
    coloured = [page for page in pages if _colour_layers(page.names)]
    coloured = coloured or [page for page in pages if {n.rpartition(".")[2].lower() for n in page.names} <= {"y", "a"}]
    main = _main_of([page.title for page in coloured]) if coloured else []
    if len(main) != 1:
        return _refused(pages, path)
    page = coloured[main[0]]
    return [Page(page.subimage, page.channels, plain_names(page.names, path))]


def _qualified(page: Page) -> Page:
    """The page with its part's name before every channel that does not bear it yet."""
    title = page.title
    names = tuple(n if not title or n.lower().startswith(title.lower()) else f"{title}.{n}" for n in page.names)
    return Page(page.subimage, page.channels, names, title)


def _refused(pages: list[Page], path: Path) -> list[Page]:
    titles = [page.title for page in pages if page.title]
    named = f" ({', '.join(titles[:6])})" if titles else ""
    raise UserError(path, f"holds {len(pages)} images{named}, and which one is meant is not known", SPLIT)
