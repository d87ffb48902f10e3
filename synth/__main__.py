"""`python -m synth OUTPUT`: the tiny synthetic captures, OUTPUT/views and OUTPUT/stage.

With `--only bowl`: OUTPUT/bowl, white plastic that lights itself; `--only printed`: OUTPUT/printed, the vase with print on it.
With `--only anisotropic`: light stages of strongly anisotropic surfaces, OUTPUT/brushed, OUTPUT/rubble and one a `--mesh`.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import time
from pathlib import Path

from pipeline.errors import UserError

LIGHTS, LIGHTS_ANISOTROPIC = 60, 346


def build(folder: Path, make, force: bool, **options: object) -> None:
    """Make one capture beside its place and move it there whole; leave a finished one alone."""
    if folder.exists() and not force:
        print(f"{folder} is there already (--force makes it again)")
        return
    started = time.monotonic()
    aside = folder.with_name(f".{folder.name}.{os.getpid()}")
    shutil.rmtree(aside, ignore_errors=True)
    make(aside, **options)
    shutil.rmtree(folder, ignore_errors=True)
    aside.rename(folder)
    print(f"{folder}: rendered in {time.monotonic() - started:.0f} s")


def main() -> int:
    """Parse, render, report; 2 on a user's mistake."""
    parser = argparse.ArgumentParser(prog="python -m synth", description=__doc__.splitlines()[0])
    parser.add_argument("output", type=Path, help="folder that receives views/ and stage/")
    parser.add_argument("--size", type=int, default=96, help="image width and height (px)")
    parser.add_argument("--views", type=int, default=16, help="number of views")
    parser.add_argument("--lights", type=int, help="number of lights of a stage (60; 346 for the anisotropic ones)")
    parser.add_argument("--spp", type=int, default=144, help="samples a pixel of the views")
    parser.add_argument("--seed", type=int, default=0, help="seed of all sampling")
    parser.add_argument(
        "--only",
        choices=("views", "stage", "bowl", "printed", "anisotropic"),
        help="make only one of the two, a white bowl, a vase with a printed label, or the harder stages",
    )
    parser.add_argument("--mesh", type=Path, nargs="*", default=[], help="meshes for more anisotropic stages")
    parser.add_argument("--force", action="store_true", help="make again what is there")
    a = parser.parse_args()
    a.lights = a.lights or (LIGHTS_ANISOTROPIC if a.only == "anisotropic" else LIGHTS)
    try:
        from . import stage_capture, view_capture

        try:
            import mitsuba  # noqa: F401
        except ImportError as error:
            remedy = "pip install -c constraints.txt '.[synth]'; apt-get install libatomic1"
            raise UserError("mitsuba", f"cannot be imported ({error})", remedy) from error
        if a.size < 16 or a.views < 1 or a.lights < 4 or a.spp < 1:
            raise UserError("--size, --views, --lights, --spp", "too small", "at least 16, 1, 4, 1")
        if a.only == "anisotropic":
            from . import anisotropic

            for name in anisotropic.scenes(a.mesh):
                options = {"name": name, "meshes": a.mesh, "size": a.size, "lights": a.lights, "seed": a.seed}
                build(a.output / name, anisotropic.build, a.force, **options)
            return 0
        if a.only in ("bowl", "printed"):
            options = {"size": a.size, "views": a.views, "spp": a.spp, "seed": a.seed, "subject": a.only}
            build(a.output / a.only, view_capture.make, a.force, **options)
            return 0
        if a.only != "stage":
            build(a.output / "views", view_capture.make, a.force, size=a.size, views=a.views, spp=a.spp, seed=a.seed)
        if a.only != "views":
            build(a.output / "stage", stage_capture.make, a.force, size=a.size, lights=a.lights, seed=a.seed)
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
