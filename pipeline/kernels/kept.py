"""Whether machine code of a file's kernels is kept already. Does not load numba."""

from __future__ import annotations

import os
from functools import cache

from pipeline.kernels import freshness, storage


@cache
def is_kept(file: str) -> bool:
    """Tell whether some kernel of a file, as it and all that it draws on are now, need not be compiled again here.

    Args:
        file: from the project's root, as "pipeline/geometry/fusion_kernel.py".

    Returns:
        Whether code of its present digest lies in the folder for compiled code.
    """
    folder, path = storage.place(), storage.ROOT / file
    if folder is None or not path.is_file():
        return False
    # A mark says that the file was loaded, which is no sign that any of its kernels was ever called.
    label = storage.label(freshness.dotted(path), freshness.digest(path))
    return any(f"-{label}." in name and not name.endswith(".mark") for name in os.listdir(folder))
