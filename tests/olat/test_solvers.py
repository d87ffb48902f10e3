"""The solver zoo on PRF's objectives: it finds what was put in, and batches are one shape."""

import numpy as np
import pytest

from benchmarks.olat_pixels import angle_deg, make
from benchmarks.olat_zoo import linear_gradient, problems
from stages.olat.pixel_fit.lobe_fit import linear_albedo
from stages.olat.pixel_fit.many_pixels import fit
from stages.olat.pixel_fit.result_layout import columns
from stages.olat.zoo import solvers as zoo
from stages.olat.zoo.paper_chain import solve_band
from tests.olat.test_recovery import DEFAULT

pytestmark = pytest.mark.slow  # jax and the kernels compile for some seconds

AT = columns()


@pytest.mark.parametrize("solver", ["gauss-newton", "lbfgs-backtracking"])
def test_a_solver_in_the_chain_finds_normals_and_albedos(solver):
    p = make(30, sigma=(0.3, 0.3), tilt_deg=40, seed=3)
    cross, parallel = p.cross.astype(np.float32), p.parallel.astype(np.float32)
    closed, _ = fit(cross, parallel, p.view, p.rig, DEFAULT)
    rows = closed.copy()
    solve_band(solver, cross, parallel, p.view, p.rig, DEFAULT, rows)
    assert np.isfinite(rows).all() and not np.array_equal(rows, closed)
    assert np.percentile(angle_deg(rows[:, AT["diffuse_normal"]], p.normal), 90) < 0.2
    if solver == "gauss-newton":  # backtracking stops early on the linear albedos: PRF's Table 3 has 3.7 for its gradient
        assert np.percentile(np.abs(rows[:, AT["diffuse_albedo"]] / p.albedo - 1), 90) < 0.01


def test_batches_of_any_size_give_the_same_answers(monkeypatch):
    p = make(10, sigma=(0.3, 0.2), noise=1e-3, seed=4)
    found, starts, _ = problems(p)
    problem = {k: v.astype(np.float32) for k, v in found["rho_d"].items()}
    whole = zoo.solve("gauss-newton", "rho_d", starts["rho_d"].astype(np.float32), problem)
    monkeypatch.setattr(zoo, "BATCH", 4)
    assert np.allclose(zoo.solve("gauss-newton", "rho_d", starts["rho_d"].astype(np.float32), problem), whole, atol=1e-6)


def test_albedos_in_float64_end_at_a_gradient_of_rounding():
    p = make(40, sigma=(0.3, 0.2), noise=1e-2, seed=5)
    found, _, _ = problems(p)
    for name, model in (("rho_d", p.normal @ p.rig.directions.T), ("rho_s", found["rho_s"]["g"])):
        data, use, zero = found[name]["data"], found[name]["use"], np.zeros(len(p.rig.directions))
        x = np.array([[linear_albedo(m, d, u, zero)] for m, d, u in zip(np.ascontiguousarray(model), data, use)])
        assert linear_gradient(x, {"model": model, "data": data, "use": use}) < 1e-12
