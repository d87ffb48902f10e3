"""The machinery that every stage stands on: captures, datasets, plans, images, cameras, optics."""

import os
import time

# pycolmap's wheel exports its own zlib; unless the system's zlib is loaded first, a later PNG save aborts the process.
import zlib  # noqa: F401

# numba would try the system's TBB first and warn where that is older than it likes (Debian 12).
os.environ.setdefault("NUMBA_THREADING_LAYER_PRIORITY", "omp workqueue tbb")

STARTED = time.time()
"""Sources changed later than this may differ from what this process imported."""
