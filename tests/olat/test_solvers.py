"""The solver zoo on PRF's objectives: it finds what was put in, and batches are one shape."""

import numpy as np
import pytest

from pipeline.errors import UserError
from stages.olat.pixel_fit.lobe_fit import linear_albedo
from stages.olat.pixel_fit.many_pixels import fit
from stages.olat.pixel_fit.result_layout import map_slices
from stages.olat.zoo import solvers as zoo
from stages.olat.zoo.paper_chain import solve_band
from synth.olat_pixels import angle_deg, make
from synth.olat_problems import gradient_norms, linear_gradient, problems

slow = pytest.mark.slow  # jax and the kernels compile for some seconds
AT = map_slices()


def available(solver: str) -> None:
    pytest.importorskip(zoo.library(solver), reason="the extra zoo is not installed")


def test_a_solver_without_its_package_is_reported_with_how_to_get_it(monkeypatch):
    monkeypatch.setattr(zoo.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"olat\.solver=optax-lbfgs: needs the package optax.*polarfield\[zoo\]"):
        zoo.check_installed("optax-lbfgs")


@slow
@pytest.mark.parametrize("solver", ["gauss-newton", "lbfgs-backtracking", "optimistix-levenberg-marquardt"])
def test_a_solver_in_the_chain_finds_normals_and_albedos(solver, settings):
    available(solver)
    p = make(30, sigma=(0.3, 0.3), tilt_deg=40, seed=3)
    cross, parallel = p.cross.astype(np.float32), p.parallel.astype(np.float32)
    closed, _ = fit(cross, parallel, p.view, p.rig, settings)
    rows = closed.copy()
    solve_band(solver, cross, parallel, p.view, p.rig, settings, rows)
    assert np.isfinite(rows).all() and not np.array_equal(rows, closed)
    assert np.percentile(angle_deg(rows[:, AT["diffuse_normal"]], p.normal), 90) < 0.2
    if solver != "lbfgs-backtracking":  # backtracking stops early on the linear albedos: PRF's Table 3 has 3.7 for its gradient
        assert np.percentile(np.abs(rows[:, AT["diffuse_albedo"]] / p.albedo - 1), 90) < 0.01


@slow
@pytest.mark.parametrize("solver", [name for name in zoo.SOLVERS if zoo.library(name) != "jaxopt"])
def test_a_solver_beside_jaxopts_finds_widths_where_the_gradient_vanishes(solver):
    available(solver)
    p = make(20, sigma=(0.3, 0.2), noise=1e-3, tilt_deg=40, seed=3)
    found, _, _ = problems(p)
    problem = {k: v.astype(np.float32) for k, v in found["sigma"].items()}
    start = np.full((20, 2), np.log(0.5), np.float32)
    x = zoo.solve(solver, "sigma", start, problem)
    assert gradient_norms("sigma", start, found["sigma"]) > 0.1
    assert gradient_norms("sigma", x, found["sigma"]) < 2 * zoo.TOLERANCE
    assert np.abs(np.exp(x) / p.sigma - 1).max() < 0.02


@slow
def test_batches_of_any_size_give_the_same_answers(monkeypatch):
    p = make(10, sigma=(0.3, 0.2), noise=1e-3, seed=4)
    found, starts, _ = problems(p)
    problem = {k: v.astype(np.float32) for k, v in found["rho_d"].items()}
    whole = zoo.solve("gauss-newton", "rho_d", starts["rho_d"].astype(np.float32), problem)
    monkeypatch.setattr(zoo, "BATCH", 4)
    assert np.allclose(zoo.solve("gauss-newton", "rho_d", starts["rho_d"].astype(np.float32), problem), whole, atol=1e-6)


@slow
def test_albedos_in_float64_end_at_a_gradient_of_rounding():
    p = make(40, sigma=(0.3, 0.2), noise=1e-2, seed=5)
    found, _, _ = problems(p)
    for name, model in (("rho_d", p.normal @ p.rig.directions.T), ("rho_s", found["rho_s"]["g"])):
        data, use, zero = found[name]["data"], found[name]["use"], np.zeros(len(p.rig.directions))
        x = np.array([[linear_albedo(m, d, u, zero)] for m, d, u in zip(np.ascontiguousarray(model), data, use)])
        assert linear_gradient(x, {"model": model, "data": data, "use": use}) < 1e-12
