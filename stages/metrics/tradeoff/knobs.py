"""The parameters that trade time for error, and the values that are tried beside a run's own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

Parameters = Mapping[str, Mapping[str, Any]]
"""Of every stage that ran, by name: as in manifests."""


@dataclass(frozen=True)
class Trial:
    """One parameter with another value, and what its stage will then take, of what it takes now (a guess, for the budget)."""

    parameter: str
    value: Any
    cost: float

    @property
    def stage(self) -> str:
        """Whose parameter it is."""
        return self.parameter.partition(".")[0]

    @property
    def text(self) -> str:
        """As PARAMS takes it."""
        value = str(self.value).lower() if isinstance(self.value, bool) else self.value
        return f"{self.parameter}={value}"


# Of a stage, the parameters that own its time first.
FACTORS = (
    ("train.iterations", ((1 / 3, 0.4), (2 / 3, 0.7), (1.6, 1.6))),
    ("train.splat_pixels", ((1.4, 0.75), (0.8, 1.3))),
    ("mesh.voxel_px", ((1.6, 0.5), (0.75, 1.8))),
    ("relight.cube", ((0.5, 0.6), (2.0, 2.5))),
)
CHOICES = (
    ("train.mirror", (("split", 0.65), ("lobe-4", 0.75), ("lobe-12", 0.95), ("lobe-48", 1.3))),
    ("train.indirect", (("none", 0.8),)),
    ("relight.mirror", (("split", 0.3), ("tree-coarse", 0.8), ("tree-fine", 1.5))),
    ("relight.indirect", (("none", 0.7),)),
    ("olat.lights", (("every=2", 0.6), ("every=4", 0.4))),
    ("olat.lobe", (("ward", 0.9),)),
    ("olat.precision", (("float64", 1.8),)),
)
WHOLE = {"train.iterations"}
CUBES = (16, 512)
"""relight.cube stays within these powers of two."""


def trials(parameters: Parameters, left_out: Iterable[str] = ()) -> list[Trial]:
    """What to try for a run with these parameters, what saves time first: the budget may end before the list does.

    Args:
        parameters: of the run.
        left_out: passes that it decided against, as "train.indirect".

    Returns:
        The trials, in order.
    """
    out = []
    for name, factors in FACTORS:
        now = _of(parameters, name)
        if isinstance(now, int | float) and not isinstance(now, bool):
            for factor, cost in factors:
                value = now * factor
                value = round(value) if name in WHOLE or name == "relight.cube" else float(f"{value:.3g}")
                if name != "relight.cube" or CUBES[0] <= value <= CUBES[1]:
                    out.append(Trial(name, value, cost))
    for name, values in CHOICES:
        now = _of(parameters, name)
        if now is not None and name not in set(left_out):
            out += [Trial(name, value, cost) for value, cost in values if value != now]
    order = ("train", "olat", "mesh", "relight")
    return sorted(out, key=lambda trial: (trial.cost > 1, order.index(trial.stage)))


def _of(parameters: Parameters, name: str) -> Any:
    stage, _, field = name.partition(".")
    return parameters.get(stage, {}).get(field)
