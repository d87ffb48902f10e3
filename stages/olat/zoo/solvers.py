"""jaxopt's solvers on PRF's objectives, batched over pixels by vmap: the paper's own way, to compare with the closed forms."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

SOLVERS = ("lbfgs-backtracking", "lbfgs-zoom", "lbfgs-hager-zhang", "gd", "ncg", "gauss-newton")
ITERATIONS = 500  # PRF, supplement C.1
TOLERANCE = 1e-4  # of the gradient, data of unit norm: a tenth of what PRF reports for the solvers that it chose
LINE_SEARCH = 15  # evaluations of one line search; a failed search ends the solver, as in PRF
BATCH = 512  # pixels solved together; the slowest of them decides how long


def applies(solver: str, quantity: str) -> bool:
    """Gauss-Newton needs a sum of squares; the normals' objectives are correlations (PRF, Table 3)."""
    return solver != "gauss-newton" or quantity in ("rho_d", "rho_s", "sigma")


@lru_cache(maxsize=64)
def _compiled(solver: str, quantity: str, shared: tuple[str, ...], names: tuple[str, ...]) -> Callable:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="JAXopt is no longer maintained")
        import jaxopt
    import jax

    from stages.olat.zoo.objectives import OBJECTIVES, RESIDUALS

    objective = OBJECTIVES[quantity]
    options = {"maxiter": ITERATIONS, "tol": TOLERANCE}
    if solver.startswith("lbfgs-"):
        search = solver.removeprefix("lbfgs-")
        tool: Any = jaxopt.LBFGS(objective, linesearch=search, stop_if_linesearch_fails=True, maxls=LINE_SEARCH, **options)
    elif solver == "gd":
        tool = jaxopt.GradientDescent(objective, maxls=LINE_SEARCH, **options)
    elif solver == "ncg":
        tool = jaxopt.NonlinearCG(objective, maxls=LINE_SEARCH, **options)
    else:
        tool = jaxopt.GaussNewton(RESIDUALS[quantity], **options)

    def one(x: Any, p: dict[str, Any]) -> Any:
        return tool.run(x, p).params

    axes = {name: None if name in shared else 0 for name in names}
    return jax.jit(jax.vmap(one, in_axes=(0, axes)))


def solve(solver: str, quantity: str, start: NDArray, problem: dict[str, NDArray], shared: tuple[str, ...] = ("w",)) -> NDArray:
    """Solve one quantity ("n_d", "rho_d", "n_s", "rho_s", "sigma") for P pixels from `start` [P, d].

    problem: arrays by the names in `objectives`, [P, ...] or, for the names in `shared`, without the first axis. float32.
    """
    import jax.numpy as jnp

    names = tuple(sorted(problem))
    run = _compiled(solver, quantity, shared, names)
    count = len(start)
    size = min(BATCH, count)
    out = []
    for first in range(0, count, BATCH):
        # every batch has the same shape, or it would be compiled again: the last one starts over with the first pixels
        part = np.arange(first, first + size) % count
        p = {k: jnp.asarray(v if k in shared else v[part]) for k, v in problem.items()}
        out.append(np.asarray(run(jnp.asarray(start[part]), p)))
    return np.concatenate(out)[:count] if out else np.zeros_like(start)


def scaled(data: NDArray, use: NDArray) -> tuple[NDArray, NDArray]:
    """Samples [P, N] with the unused at 0 and unit norm per pixel, and the norms [P, 1]."""
    data = data * use
    norm = np.maximum(np.linalg.norm(data, axis=1, keepdims=True), np.finfo(np.float32).tiny)
    return data / norm, norm
