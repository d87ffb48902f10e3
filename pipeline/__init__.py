"""The machinery that every stage stands on: captures, datasets, plans, images, cameras, optics."""

# pycolmap's wheel exports its own zlib; unless the system's zlib is loaded first, a later PNG save aborts the process.
import zlib  # noqa: F401
