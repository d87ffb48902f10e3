"""LPIPS (Zhang et al. 2018), where its library and the weights of its network lie on this machine: nothing is downloaded."""

from __future__ import annotations

import importlib.util
import os
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

WEIGHTS = "alexnet-owt-7be5be79.pth"
"""Torchvision's AlexNet, which LPIPS compares features of."""


def missing() -> str:
    """Why there is no LPIPS here; empty where there is."""
    for library in ("lpips", "torchvision"):
        if importlib.util.find_spec(library) is None:
            return f"{library} is not installed"
    if not _weights().is_file():
        return f"there are no weights at {_weights()}"
    return ""


def lpips(image: NDArray, truth: NDArray) -> float | None:
    """Distance of two display images [H, W, 3] in 0..1; None where `missing` says why, or they are smaller than the network
    takes."""
    if missing() or min(image.shape[:2]) < 32:
        return None
    import torch

    a, b = (torch.as_tensor(np.moveaxis(np.asarray(x, np.float32), -1, 0)[None]) * 2 - 1 for x in (image, truth))
    with torch.no_grad():
        return float(_network()(a, b))


def _weights() -> Path:
    home = os.environ.get("TORCH_HOME") or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "torch"
    return Path(home) / "hub" / "checkpoints" / WEIGHTS


@cache
def _network() -> Any:
    import lpips as library  # type: ignore[import-not-found, unused-ignore]

    return library.LPIPS(net="alex", verbose=False).eval()
