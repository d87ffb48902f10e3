"""A batch on Snakemake: `workflow/Snakefile` over the plan, local or on the executor that is asked for."""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

from pipeline.engine.child import stage_environment
from pipeline.engine.interrupts import in_child, wait_for
from pipeline.errors import UserError

ROOT = Path(__file__).resolve().parents[3]
ALONE = ("--executor", "-e", "--profile", "--workflow-profile")


def snakefile() -> Path:
    """The workflow that ships with the program. Raises UserError where it was not installed."""
    for folder in (ROOT, Path(sys.prefix) / "share" / "polarfield"):
        if (path := folder / "workflow" / "Snakefile").is_file():
            return path
    raise UserError("workflow/Snakefile", "is not there", "install the program again")


def run_snakemake(plan: Path, text: str, jobs: int, cores: int, memory_mb: float) -> int:
    """Run the jobs of a plan; `text`: more arguments for Snakemake. Returns its exit status. Raises UserError.

    Without an executor or a profile in `text` the jobs run here: `jobs` at once, within the memory.
    """
    if importlib.util.find_spec("snakemake") is None:
        raise UserError("--snakemake", "Snakemake is not installed", "pip install 'polarfield[cluster]'")
    try:
        given = shlex.split(text)
    except ValueError as error:
        raise UserError("--snakemake", f"cannot be split ({error})", "quote values that hold spaces") from error
    own = plan.parent
    shutil.rmtree(own / "made", ignore_errors=True)
    local = not any(argument.partition("=")[0] in ALONE for argument in given)
    limits = ["--cores", str(jobs * cores), "--resources", f"mem_mb={int(memory_mb)}"] if local else ["--jobs", str(jobs)]
    line = [sys.executable, "-m", "snakemake", "--snakefile", str(snakefile()), "--directory", str(own)]
    line += ["--config", f"plan={plan.absolute()}", "--keep-going", "--rerun-incomplete", "--rerun-triggers", "mtime"]
    line += ["--scheduler", "greedy", "--drop-metadata", "--nolock", *limits, *given]
    # A cache of its own beside the plan: a home folder may be read-only on a node.
    environment = {**stage_environment(), "XDG_CACHE_HOME": os.environ.get("XDG_CACHE_HOME", str((own / "cache").absolute()))}
    log = own / "snakemake.log"
    with log.open("ab") as stream:
        return wait_for(subprocess.Popen(line, env=environment, preexec_fn=in_child, stdout=stream, stderr=stream))
