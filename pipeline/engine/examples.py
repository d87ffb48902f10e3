"""Calls of each command that show what it is for, as its help ends with them."""

from __future__ import annotations

import argparse
from typing import Any

HEAD = "examples:"
EXAMPLES: dict[str, tuple[str, ...]] = {
    "": ("polarfield inspect captures/vase", "polarfield all captures/vase", "polarfield mesh --help"),
    "all": (
        "polarfield all captures/vase",
        'polarfield all captures/vase --params "train.iterations=1200 mesh.poisson=true" --envs "room.hdr clear_sky"',
        "polarfield all captures/vase --dataset /data/vase --device cuda --memory 12G",
    ),
    "plan": ("polarfield plan captures/vase",),
    "inspect": ("polarfield inspect captures/vase",),
    "report": ("polarfield report --dataset datasets/vase",),
    "compare": ("polarfield compare datasets/vase datasets/vase-again --out comparison",),
    "export": (
        "polarfield export --dataset datasets/vase --to glb",
        "polarfield export captures/vase --to splat --out vase-splats",
        "polarfield export --dataset datasets/stage --to maps",
    ),
    "tradeoff": ("polarfield tradeoff captures/vase",),
    "verify": ("polarfield verify --dataset datasets/vase --full",),
    "batch": ("polarfield batch captures --jobs 4", "polarfield batch list.txt --slurm --sbatch='--time=4:00:00'"),
    "gc": ("polarfield gc --dataset datasets/vase --dry-run",),
    "completion": (
        "bash: polarfield completion bash > ~/.local/share/bash-completion/completions/polarfield",
        "zsh:  polarfield completion zsh > ~/.zfunc/_polarfield   (with fpath+=~/.zfunc before compinit)",
        "fish: polarfield completion fish > ~/.config/fish/completions/polarfield.fish",
    ),
}


class WithExamples(argparse.HelpFormatter):
    """Wraps prose as argparse does, and leaves the lines of examples as they are."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        prose, head, calls = text.partition(HEAD)
        wrapped = super()._fill_text(prose, width, indent) if prose.strip() else ""
        return wrapped + ("\n\n" if wrapped and head else "") + head + calls


def ending(command: str, prose: str) -> dict[str, Any]:
    """What an argument parser of `command` is told, so that its help ends with prose and examples."""
    calls = EXAMPLES.get(command) or (f"polarfield {command} captures/vase", f"polarfield {command} --dataset datasets/vase")
    return {"epilog": f"{prose}{HEAD}\n" + "\n".join(f"  {call}" for call in calls), "formatter_class": WithExamples}
