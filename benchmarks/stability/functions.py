"""Every public function of the optics in float32 and float64 against 60-digit arithmetic, values and gradients."""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
import torch
from mpmath import im, isinf, mp, mpf, re
from numpy.typing import NDArray

from benchmarks.stability import grids, truths
from benchmarks.stability.verdicts import Row
from pipeline.optics import fresnel, microfacet, mueller, stokes

STEP = mpf("1e-22")  # of the central difference at 60 digits: 38 digits are left
ELEMENTS = 100_000
VALUE, BESIDE_ZERO = 1e-5, 0.1
"""What a float32 value may be off, of itself; of this where the function crosses 0 (1e-6 in all)."""


@dataclass(frozen=True)
class Case:
    """A function of columns of points [N, k], and what it should be."""

    function: Callable[..., Any]
    truth: Callable[..., Any]
    points: Callable[[], NDArray[np.float64]]
    call: Callable[..., Any] | None = None  # where the function takes its columns otherwise
    approximation: float = 0.0  # what it is documented to be off by, as an approximation
    name: str = ""
    zeros: Callable[..., float] | bool = False  # True: crosses 0, and 0.1 stands for its size there; or what does, of the point
    smooth: bool = True  # False where the true gradient jumps or is infinite on the grid: finite is all that is asked

    @property
    def title(self) -> str:
        """Module and name."""
        return self.name or f"{self.function.__module__.rsplit('.', 1)[-1]}.{self.function.__name__}"


def _surface_pattern(x: Any, y: Any) -> tuple[Any, Any]:
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    across, up = torch.stack((one, zero, zero), -1), torch.stack((zero, one, zero), -1)
    return stokes.surface_pattern(torch.stack((x, y, zero), -1), across, up)


def _stacked(function: Callable[[Any], Any]) -> Callable[..., Any]:
    return lambda *columns: function(torch.stack(columns, -1))


def _lobe(function: Callable[..., Any], lobe: str) -> Callable[..., Any]:
    return lambda *columns: function(*columns, lobe)


CASES = (
    Case(fresnel.normal_reflectance, lambda eta: ((eta - 1) / (eta + 1)) ** 2, grids.ior),
    Case(fresnel.schlick, truths.schlick, grids.cosine_and_ior),
    Case(fresnel.amplitudes, truths.opposed_amplitudes, grids.cosine_and_ior, zeros=True),
    Case(fresnel.reflectances, truths.powers, grids.cosine_and_ior, zeros=True),
    Case(fresnel.reflectance, lambda c, eta: sum(truths.powers(c, eta)) / 2, grids.cosine_and_ior),
    Case(fresnel.transmittances, lambda c, eta: tuple(1 - r for r in truths.powers(c, eta)), grids.cosine_and_ior),
    Case(fresnel.transmittance, lambda c, eta: 1 - sum(truths.powers(c, eta)) / 2, grids.cosine_and_ior),
    Case(fresnel.specular_polarisation, truths.specular_polarisation, lambda: grids.with_sine(grids.cosine_and_ior())),
    Case(fresnel.diffuse_polarisation, truths.diffuse_polarisation, grids.cosine_and_ior),
    Case(fresnel.hemispherical_transmittance, truths.hemispherical_transmittance, grids.ior, approximation=7e-7),
    Case(microfacet.ggx_distribution, truths.ggx_distribution, grids.cosine_and_alpha),
    Case(
        microfacet.beckmann_distribution, truths.beckmann_distribution, grids.cosine_and_alpha,
        zeros=lambda nh, alpha: 1 / (np.pi * alpha**2),
    ),
    Case(microfacet.ggx_lambda, truths.ggx_lambda, grids.cosine_and_alpha),
    Case(microfacet.beckmann_lambda, truths.beckmann_fit, grids.cosine_and_alpha, zeros=True, smooth=False),
    Case(
        microfacet.masking, lambda c, a: 1 / (1 + truths.ggx_lambda(c, a)), grids.cosine_and_alpha,
        _lobe(microfacet.masking, "ggx"), name="microfacet.masking ggx",
    ),
    Case(
        microfacet.masking, lambda c, a: 1 / (1 + truths.beckmann_lambda(c, a)), grids.cosine_and_alpha,
        _lobe(microfacet.masking, "beckmann"), 3.5e-3, "microfacet.masking beckmann", smooth=False,
    ),
    Case(
        microfacet.separable_shadowing, lambda v, l, a: 1 / (1 + truths.ggx_lambda(v, a)) / (1 + truths.ggx_lambda(l, a)),
        grids.two_cosines_and_alpha, _lobe(microfacet.separable_shadowing, "ggx"),
    ),
    Case(stokes.degree, truths.degree, grids.stokes, _stacked(stokes.degree), smooth=False),
    Case(stokes.angle, truths.angle, grids.stokes, _stacked(stokes.angle), smooth=False),
    Case(stokes.angle_difference, truths.angle_difference, grids.two_angles, zeros=True, smooth=False),
    Case(stokes.polariser_row, lambda t, e: truths.polariser(t, e)[:3], grids.angle_and_extinction, zeros=True),
    Case(stokes.surface_pattern, lambda x, y: ((x - y) * (x + y), 2 * x * y), grids.projections, _surface_pattern, zeros=True),
    Case(mueller.rotation, truths.rotation, grids.angles, zeros=True),
    Case(mueller.polariser, truths.polariser, grids.angle_and_extinction, zeros=True),
    Case(mueller.reflection, truths.reflection, grids.cosine_and_ior, zeros=True),
    Case(mueller.transmission, truths.transmission, grids.cosine_and_ior, zeros=True),
)  # fmt: skip
ELSEWHERE = {"beckmann_lambda_exact"}
"""Public functions of scalars in float64 alone; tests hold them."""


def public(modules: Sequence[ModuleType] = (fresnel, microfacet, stokes, mueller)) -> set[str]:
    """Names of the functions that must have a case."""
    return {
        name
        for module in modules
        for name, value in vars(module).items()
        if inspect.isfunction(value)
        and value.__module__ == module.__name__
        and not name.startswith("_")
        and name not in ELSEWHERE
    }


def _columns(points: NDArray[np.float64], dtype: torch.dtype) -> list[torch.Tensor]:
    return [torch.as_tensor(x, dtype=dtype).clone() for x in points.T]


def _components(value: Any) -> torch.Tensor:
    """[N, components] of a tensor or a tuple of them."""
    parts = value if isinstance(value, tuple) else (value,)
    return torch.cat([x.reshape(len(x), -1) for x in parts], 1)


def _true(case: Case, rows: Sequence[Sequence[float]]) -> tuple[NDArray[np.object_], NDArray[np.float64]]:
    """Values [N, C] at 60 digits, and gradients [N, C, k]."""

    def at(point: Sequence[Any]) -> tuple[Any, ...]:
        value = case.truth(*point)
        return value if isinstance(value, tuple) else (value,)

    values, slopes = [], []
    for row in rows:
        point = [mpf(x) for x in row]
        values.append(at(point))
        gradient = []
        for k, x in enumerate(point):
            if not case.smooth or isinf(x):
                gradient.append([0.0] * len(values[-1]))
                continue
            step = STEP * max(abs(x), mpf("1e-6"))
            ends = [(side * step, at([*point[:k], x + side * step, *point[k + 1 :]])) for side in (1, -1)]
            # One-sided where the argument ends: a step further is no real number.
            high, low = ((d, v) if all(im(y) == 0 for y in v) else (mpf(0), values[-1]) for d, v in ends)
            gradient.append([float(re((h - l) / (high[0] - low[0]))) for h, l in zip(high[1], low[1])])
        slopes.append(np.array(gradient).T)
    return np.array(values, object), np.array(slopes)


def rows() -> Iterator[Row]:
    """A row for each function and precision."""
    mp.dps = truths.DIGITS
    for case in CASES:
        call = case.call or case.function
        for dtype, name in ((torch.float32, "float32"), (torch.float64, "float64")):
            yield _row(case, call, dtype, name)


def _row(case: Case, call: Callable[..., Any], dtype: torch.dtype, name: str) -> Row:
    columns = [x.requires_grad_() for x in _columns(case.points(), dtype)]
    value = _components(call(*columns))
    points = torch.stack([x.detach() for x in columns], 1).double().numpy()
    exact, slopes = _true(case, points.tolist())
    truth, got = np.abs(exact.astype(float)), value.detach().double().numpy()
    there = truth < float(torch.finfo(dtype).max)
    off = np.array([[abs(float(mpf(g) - t)) if np.isfinite(g) else np.inf for g, t in zip(*pair)] for pair in zip(got, exact)])
    beside = np.array([[case.zeros(*p)] for p in points]) if callable(case.zeros) else 1.0 if case.zeros else 0.0
    size = np.maximum(truth, np.maximum(BESIDE_ZERO * beside, float(torch.finfo(dtype).tiny)))
    relative = np.where(there, off / size, 0)
    gradient = _gradients(value, columns)
    finite = np.isfinite(gradient)
    figures = {
        "value": float(relative.max()),
        "absolute": float(off[there].max()),
        "gradient": _slope_error(gradient, slopes, finite) if case.smooth else float("nan"),
        "not_finite": int((~finite).sum() + (~np.isfinite(got) & there).sum()),
        "ns": _nanoseconds(call, case.points(), dtype),
    }
    bar = VALUE * (1.0 if dtype is torch.float32 else 1e-7) + case.approximation
    worst = ", ".join(f"{x:.6g}" for x in points[int(relative.max(1).argmax())])
    return Row("functions", case.title, name, figures, bool(relative.max() <= bar and finite.all()), worst)


def _gradients(value: torch.Tensor, columns: Sequence[torch.Tensor]) -> NDArray[np.float64]:
    """[N, components, arguments] by autograd."""
    out = np.zeros((len(value), value.shape[1], len(columns)))
    for k in range(value.shape[1]):
        for j, gradient in enumerate(torch.autograd.grad(value[:, k].sum(), columns, retain_graph=True)):
            out[:, k, j] = gradient.double().numpy()
    return out


def _slope_error(gradient: NDArray[np.float64], slopes: NDArray[np.float64], finite: NDArray[np.bool_]) -> float:
    """Largest error of a gradient, of itself; of a thousandth of the argument's largest (1 at most) where it vanishes."""
    scale = np.minimum(1e-3 * np.abs(slopes).max((0, 1), keepdims=True).clip(1e-30), 1.0)
    return float(np.where(finite, np.abs(gradient - slopes) / np.maximum(np.abs(slopes), scale), 0).max())


def _nanoseconds(call: Callable[..., Any], points: NDArray[np.float64], dtype: torch.dtype) -> float:
    """Time per element of a forward call on one thread, the median of five."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    columns = _columns(np.resize(points, (ELEMENTS, points.shape[1])), dtype)
    times = []
    for _ in range(5):
        start = time.perf_counter()
        call(*columns)
        times.append(time.perf_counter() - start)
    torch.set_num_threads(threads)
    return float(np.median(times)) / ELEMENTS * 1e9
