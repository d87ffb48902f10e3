"""Make one version of one stage: resume, watch the cost, publish whole."""

from __future__ import annotations

import errno
import importlib.metadata
import os
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.capture import Capture
from pipeline.engine.costs.estimate import Estimator, Expected
from pipeline.engine.costs.probe import machine
from pipeline.engine.costs.rates import record_of, remember
from pipeline.engine.dataset import Dataset, Version
from pipeline.engine.dataset.digests import digest_file
from pipeline.engine.dataset.usage import Usage
from pipeline.engine.inputs_check import cause, published, refuse_unsafe_tables
from pipeline.engine.memory import Allowance
from pipeline.engine.plan import Step, as_json
from pipeline.engine.progress import Progress, brief
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError

PACKAGES = {
    "numpy": "numpy", "OpenImageIO": "OpenImageIO", "torch": "torch", "numba": "numba", "jax": "jax", "jaxopt": "jaxopt",
    "optimistix": "optimistix", "optax": "optax", "open3d": "open3d", "pycolmap": "pycolmap", "rawpy": "rawpy",
    "scipy": "scipy", "cv2": "opencv-python-headless", "skimage": "scikit-image", "gsplat": "gsplat",
    "transformers": "transformers",
}  # fmt: skip


def make_version(
    dataset: Dataset,
    capture: Capture,
    step: Step,
    environments: tuple[Path, ...],
    device: str,
    allowed: Allowance,
    progress: Progress,
    plan: Sequence[Step] = (),
) -> Version:
    """The version of `step` (one of `plan`): the published one where there is one, else made now. Raises UserError."""
    name, key = step.stage.name, step.key
    if version := dataset.find(name, key):
        return version

    def waiting() -> None:
        progress.say(f"{name}: another run is making this version; waiting for it")

    with dataset.making(name, key, waiting) as work:
        if version := dataset.find(name, key):
            return version
        estimator = Estimator(capture, plan or [step], dataset, device)
        expected = estimator.expected(step)
        progress.say(f"{name}: {_beginning(step, expected, allowed, resumed=(work / 'usage.json').exists())}")
        output, scratch = _folders(work)
        upstream = {n: published(dataset, n, step.inputs["stages"][n]) for n in step.needs}
        refuse_unsafe_tables(dataset, upstream.values())
        folders = {n: version.folder for n, version in upstream.items()}
        run = StageRun(capture, step.parameters, folders, output, scratch, device, environments, progress, allowed.jobs)
        run.left_out = {name: left.as_json() for name, left in estimator.left_out().items()}
        usage = Usage(work / "usage.json", allowed.limit_mb, lambda: _stop_at_once(allowed.overrun(name)))
        try:
            step.stage.run(run)
            figures = {**usage.stop(), **_expected(expected, allowed)}
            _refuse_changed_files(dataset, step)
            version = dataset.publish(name, key, output, _manifest(step, run, output, figures))
        except OSError as error:
            raise _target_fault(error, dataset.root) from error
        except Exception as error:
            _refuse_changed_files(dataset, step)
            found = cause(error, dataset, upstream)
            if found is error:
                raise
            raise found from error
        finally:
            usage.stop()
        dataset.clear_work(name, key)
        _remember(version, step, expected, device)
        progress.say(f"{name}: done in {brief(float(figures['wall_s']))}, {figures['peak_rss_mb']:.0f} MB")
        return version


def _beginning(step: Step, expected: Expected | None, allowed: Allowance, resumed: bool) -> str:
    """What is said as a stage begins."""
    about = f"{brief(expected.wall_s)} and " if expected else ""
    why = f"{step.decision.reason}; about {about}{allowed.expected_mb:.0f} MB of memory"
    return f"{'resuming' if resumed else 'running'} ({why})"


def _expected(expected: Expected | None, allowed: Allowance) -> dict[str, float]:
    """What was foretold, for the manifest."""
    times = {"expected_wall_s": round(expected.wall_s, 3), "expected_cpu_s": round(expected.cpu_s, 3)} if expected else {}
    return {"expected_rss_mb": round(allowed.expected_mb, 1), **times}


def _remember(version: Version, step: Step, expected: Expected | None, device: str) -> None:
    """Keep what this run shows of the machine's rates."""
    record = record_of(version.manifest, expected.estimate_s) if expected else None
    if record is not None:
        remember(step.stage.name, device if step.stage.device else "cpu", record)


def _folders(work: Path) -> tuple[Path, Path]:
    """An empty folder for the output, and one that keeps what an earlier leg left."""
    output, scratch = work / "output", work / "scratch"
    if output.exists():
        shutil.rmtree(output)
    output.mkdir()
    scratch.mkdir(exist_ok=True)
    return output, scratch


def _stop_at_once(line: str) -> None:
    """End this process from a thread that watches it: what allocates may be a library that hears no signal.

    Nothing is lost that a kill would not lose, and nothing half-written is ever published.
    """
    print(f"polarfield: {line}", file=sys.stderr, flush=True)
    os._exit(UserError.status)


def _refuse_changed_files(dataset: Dataset, step: Step) -> None:
    """Raise UserError where a file that the stage read is another than when the work was planned; its work is dropped."""
    changed = dataset.digests.altered(step.files)
    if changed is not None:
        dataset.clear_work(step.stage.name, step.key)
        fault = f"was changed while {step.stage.name} ran, so that its result was dropped"
        raise UserError(changed, fault, "the same command goes on from here, once the file stays as it is")


def _manifest(step: Step, run: StageRun, output: Path, figures: Mapping[str, Any]) -> dict[str, Any]:
    files = sorted(p for p in output.rglob("*") if p.is_file())
    outputs = [{"path": p.relative_to(output).as_posix(), "bytes": p.stat().st_size, "digest": digest_file(p)} for p in files]
    return {
        "schema": 1,
        "stage": step.stage.name,
        "key": step.key,
        "version": step.stage.version,
        "parameters": as_json(step.parameters),
        "inputs": step.inputs,
        "outputs": outputs,
        **figures,
        "compile_s": _compile_s(),
        "machine": machine(),
        "device": run.device,
        "packages": _packages(),
        "warnings": run.warnings,
        "facts": as_json(run.facts),
        "decision": replace(step.decision).as_json(),
    }


def _compile_s() -> float:
    """Seconds of the stage that went into compiling kernels, which the next run on this machine will not take."""
    compiling = sys.modules.get("pipeline.kernels.compiling")  # a stage without kernels does not load numba
    return round(compiling.compile_seconds(), 3) if compiling else 0.0


def _packages() -> dict[str, str]:
    """Versions of the libraries that this process has loaded."""
    loaded = {package for module, package in PACKAGES.items() if module in sys.modules}
    return {"python": sys.version.split()[0], **{p: importlib.metadata.version(p) for p in sorted(loaded)}}


def _target_fault(error: OSError, root: Path) -> Exception:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return UserError(root, "no space left on the target", "free some space or choose another DATASET=")
    if error.errno in (errno.EROFS, errno.EACCES, errno.EPERM):
        return UserError(error.filename or root, f"cannot be used ({error.strerror})", "check its permissions")
    return error
