"""Solvers on PRF's objectives, batched over pixels by vmap: the paper's own way, to compare with the closed forms.

jaxopt's are those of PRF's Table 3. It is no longer maintained: optimistix's and optax's (extra `zoo`) stand beside it.
"""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Callable
from functools import lru_cache
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from stages.olat.parameters import Solver

SOLVERS = tuple(name for name in get_args(Solver) if name not in ("closed", "gradient"))
LEAST_SQUARES = ("gauss-newton", "optimistix-gauss-newton", "optimistix-levenberg-marquardt")
ITERATIONS = 500  # PRF, supplement C.1
TOLERANCE = 1e-4  # of the gradient, data of unit norm: a tenth of what PRF reports for the solvers that it chose
LINE_SEARCH = 15  # evaluations of one line search; a failed search ends the solver, as in PRF
BATCH = 512  # pixels solved together; the slowest of them decides how long

Solve = Callable[[Any, dict[str, Any]], Any]
"""From the start [d] and the problem of one pixel to the unknowns [d] at the end."""


def applies(solver: str, quantity: str) -> bool:
    """Whether a solver can find a quantity: Gauss-Newton and Levenberg-Marquardt need a sum of squares.

    The normals' objectives are correlations (PRF, Table 3).
    """
    return solver not in LEAST_SQUARES or quantity in ("rho_d", "rho_s", "sigma")


def library(solver: str) -> str:
    """The package that a solver comes from: its name says so, but for jaxopt's, which bear PRF's names."""
    first = solver.partition("-")[0]
    return first if first in ("optimistix", "optax") else "jaxopt"


def check_installed(solver: str) -> None:
    """Raise UserError where the package of `solver` is missing."""
    package = library(solver)
    if importlib.util.find_spec(package) is None:
        raise UserError(f"olat.solver={solver}", f"needs the package {package}", "pip install 'polarfield[zoo]'")


def _of_jaxopt(solver: str, objective: Callable, residual: Callable | None) -> Solve:
    """One of jaxopt's solvers; each ends at a gradient norm of `TOLERANCE`."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="JAXopt is no longer maintained")
        import jaxopt

    options = {"maxiter": ITERATIONS, "tol": TOLERANCE}
    if solver.startswith("lbfgs-"):
        search = solver.removeprefix("lbfgs-")
        tool: Any = jaxopt.LBFGS(objective, linesearch=search, stop_if_linesearch_fails=True, maxls=LINE_SEARCH, **options)
    elif solver == "gd":
        tool = jaxopt.GradientDescent(objective, maxls=LINE_SEARCH, **options)
    elif solver == "ncg":
        tool = jaxopt.NonlinearCG(objective, maxls=LINE_SEARCH, **options)
    else:
        tool = jaxopt.GaussNewton(residual, **options)
    return lambda x, p: tool.run(x, p).params


def _of_optimistix(solver: str, objective: Callable, residual: Callable | None) -> Solve:
    """One of optimistix's solvers. They end when a step changes neither the unknowns nor the cost by `TOLERANCE`.

    Their own rule: a step of that size is a gradient of that size where the curvature is about one, as it is at unit norm.
    """
    import optimistix

    tools: dict[str, Any] = {
        "optimistix-lbfgs": optimistix.LBFGS, "optimistix-bfgs": optimistix.BFGS, "optimistix-ncg": optimistix.NonlinearCG,
        "optimistix-gauss-newton": optimistix.GaussNewton,
        "optimistix-levenberg-marquardt": optimistix.LevenbergMarquardt,
    }  # fmt: skip
    tool = tools[solver](rtol=TOLERANCE, atol=TOLERANCE)
    find: Any = optimistix.least_squares if solver in LEAST_SQUARES else optimistix.minimise
    cost = residual if solver in LEAST_SQUARES else objective
    return lambda x, p: find(cost, tool, x, args=p, max_steps=ITERATIONS, throw=False).value


def _of_optax(objective: Callable) -> Solve:
    """optax's L-BFGS with its zoom line search, to a gradient norm of `TOLERANCE`."""
    import jax
    import jax.numpy as jnp
    import optax

    search = optax.scale_by_zoom_linesearch(max_linesearch_steps=LINE_SEARCH)
    tool = optax.lbfgs(linesearch=search)

    def run(x: Any, p: dict[str, Any]) -> Any:
        def cost(y: Any) -> Any:
            return objective(y, p)

        slope = optax.value_and_grad_from_state(cost)

        def step(carry: tuple[Any, Any, Any, Any]) -> tuple[Any, Any, Any, Any]:
            y, state, count, _ = carry
            value, gradient = slope(y, state=state)
            change, state = tool.update(gradient, state, y, value=value, grad=gradient, value_fn=cost)
            searched = optax.tree_utils.tree_get(state, "num_linesearch_steps")
            ended = jnp.linalg.norm(optax.tree_utils.tree_get(state, "grad")) <= TOLERANCE
            return optax.apply_updates(y, change), state, count + 1, ended | (searched >= LINE_SEARCH)

        def unfinished(carry: tuple[Any, Any, Any, Any]) -> Any:
            return (carry[2] < ITERATIONS) & ~carry[3]

        return jax.lax.while_loop(unfinished, step, (x, tool.init(x), 0, jnp.asarray(False)))[0]

    return run


@lru_cache(maxsize=64)
def _compiled(solver: str, quantity: str, shared: tuple[str, ...], names: tuple[str, ...]) -> Callable:
    import jax

    from stages.olat.zoo.objectives import OBJECTIVES, RESIDUALS

    objective, residual = OBJECTIVES[quantity], RESIDUALS.get(quantity)
    build = {"jaxopt": _of_jaxopt, "optimistix": _of_optimistix}.get(library(solver))
    one = build(solver, objective, residual) if build else _of_optax(objective)
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
