"""Maps written scanline by scanline as the bands are fitted, so that memory does not grow with the image."""

from __future__ import annotations

import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.image_output import reason_of, write_fault
from pipeline.formats.truncation import exr_chunks_in_place
from stages.olat.pixel_fit.result_layout import MAPS, ON_REQUEST, map_slices
from stages.olat.reading.scanline_bands import Band

COARSE = ("occlusion_d", "occlusion_s", "visibility_d", "visibility_s", "interreflection_d", "interreflection_s")
"""Maps that half floats hold well; the others are float32."""
SHOWN = ("sigma", "residual")
"""Maps of two numbers: these stand as R and G (half floats, B 0) beside the named channels, for programs that would show a
picture's Y alone."""
PREVIEW = 480  # pixels of a preview's longer side
READ_ROWS = 256  # looked at again at a time
CHUNK_ROWS = 16  # that zip compresses together


class MapWriter:
    """Open EXR files of one camera's maps; rows are written from the top down, 0 where nothing was fitted."""

    def __init__(self, folder: Path, width: int, height: int, asked: tuple[str, ...] = ()) -> None:
        """Create the folder and the files, of `ON_REQUEST` those `asked` for. Raises UserError when it cannot be written."""
        import OpenImageIO as oiio

        self.folder, self.width, self.height, self.row = folder, width, height, 0
        folder.mkdir(parents=True, exist_ok=True)
        self.files, self.sums = {}, dict.fromkeys(MAPS, 0)
        for name, channels in MAPS.items():
            if name in ON_REQUEST and name not in asked:
                continue
            kind = "half" if name in COARSE else "float"
            shown = ("R", "G", "B") if name in SHOWN else ()
            spec = oiio.ImageSpec(width, height, len(channels) + len(shown), kind)
            spec.channelnames = (*channels, *shown)
            spec.channelformats = (*(kind,) * len(channels), *("half",) * len(shown)) if shown else ()
            spec.attribute("compression", "zip")
            spec.attribute("DateTime", "2000:01:01 00:00:00")  # otherwise the clock would change the bytes
            path = folder / f"{name}.exr"
            out = oiio.ImageOutput.create(str(path))
            if out is None or not out.open(str(path), spec):
                raise write_fault(path, (out.geterror() if out is not None else oiio.geterror()).strip())
            self.files[name] = out
        self.pool = ThreadPoolExecutor(2)  # OpenImageIO compresses outside the interpreter's lock
        self.step = max(1, -(-max(width, height) // PREVIEW))
        self.preview = np.zeros((-(-height // self.step), -(-width // self.step), sum(map(len, MAPS.values()))), np.float32)

    def write(self, band: Band, rows: NDArray[np.float64]) -> None:
        """Write a band's results [P, WIDTH], and the empty rows above it."""
        self._skip_to(band.top)
        strip = np.zeros(((band.bottom - band.top) * self.width, rows.shape[1]), np.float32)
        strip[band.pixels - band.top * self.width] = rows
        self._rows(strip.reshape(band.bottom - band.top, self.width, -1))

    def close(self) -> None:
        """Write the empty rows at the bottom and finish the files."""
        self._skip_to(self.height)
        self.pool.shutdown()
        for name, out in self.files.items():
            if not out.close():
                raise write_fault(self.folder / f"{name}.exr", out.geterror().strip())
        for name in self.files:
            self._look_again(name)

    def _look_again(self, name: str) -> None:
        """Read a finished map: OpenImageIO takes a file for written of which a part was not. Raises UserError then."""
        import OpenImageIO as oiio

        path, found = self.folder / f"{name}.exr", 0
        image = oiio.ImageInput.open(str(path))
        if image is None:
            raise write_fault(path, reason_of(oiio))
        names = image.spec().channelnames  # of which OpenImageIO puts R, G, B first
        own = [names.index(channel) for channel in MAPS[name]]
        for top in range(0, self.height, READ_ROWS):
            bottom = min(top + READ_ROWS, self.height)
            rows = image.read_scanlines(top, bottom, 0, 0, len(names), "half" if name in COARSE else "float")
            if rows is None:
                raise write_fault(path, reason_of(image))
            found = zlib.crc32(np.ascontiguousarray(rows[..., own]).data, found)
        image.close()
        if found != self.sums[name] or not exr_chunks_in_place(path, self.height, CHUNK_ROWS):
            raise write_fault(path, "what it holds is not what was written")

    def __enter__(self) -> MapWriter:
        """The writer itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Finish the files unless something went wrong."""
        if kind is None:
            self.close()
        self.pool.shutdown()

    def _skip_to(self, row: int) -> None:
        while self.row < row:
            count = min(64, row - self.row)
            self._rows(np.zeros((count, self.width, self.preview.shape[2]), np.float32))

    def _rows(self, strip: NDArray[np.float32]) -> None:
        top = self.row

        def write(name: str, place: slice) -> None:
            part = np.ascontiguousarray(strip[..., place], np.float16 if name in COARSE else np.float32)
            self.sums[name] = zlib.crc32(part.data, self.sums[name])
            if name in SHOWN:
                part = np.concatenate([part, part, np.zeros_like(part[..., :1])], -1)
            if not self.files[name].write_scanlines(top, top + len(strip), 0, part):
                raise write_fault(self.folder / f"{name}.exr", self.files[name].geterror().strip())

        slices = map_slices()
        list(self.pool.map(write, self.files, [slices[name] for name in self.files]))
        self.row = top + len(strip)
        first = -top % self.step
        picked = strip[first :: self.step, :: self.step]
        at = (top + first) // self.step
        self.preview[at : at + len(picked)] = picked
