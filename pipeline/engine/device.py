"""Which device training runs on."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import UserError


def refuse_missing_cuda() -> None:
    """Raise UserError where training on the GPU cannot be, before anything runs."""
    import importlib.util

    import torch

    if not torch.cuda.is_available():
        build = "" if torch.version.cuda else ", and this build of torch has no CUDA"
        raise UserError("DEVICE (--device)", f"cuda: no usable GPU is here{build}", "give cpu, or auto")
    if importlib.util.find_spec("gsplat") is None:
        raise UserError("DEVICE (--device)", "cuda: gsplat is not installed", "pip install gsplat, or give cpu")


def device_of(choice: str) -> str:
    """`cpu` or `cuda`, as a call names it or (`auto`) as the machine has it."""
    if choice != "auto":
        return choice
    import importlib.util

    if not Path("/dev/nvidiactl").exists() or importlib.util.find_spec("gsplat") is None:
        return "cpu"  # decided without importing torch
    import torch

    return "cuda" if torch.cuda.is_available() else "cpu"
