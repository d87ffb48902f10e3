"""A Slurm of one machine for tests: `sbatch` and `scontrol requeue`, the tasks of an array run at once and some killed.

Called as `sbatch` it runs the job to its end before it prints the number. FAKE_SLURM names a folder for its notes;
FAKE_SLOTS tasks run side by side; FAKE_KILLS="SHARE,SEED,SECONDS" kills that share of first tries, the whole job or the work
alone, after a random time up to so many seconds.
"""

from __future__ import annotations

import os
import random
import re
import shlex
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

NOTES = Path(os.environ["FAKE_SLURM"])
SHARE, SEED, SECONDS = (float(x) for x in os.environ.get("FAKE_KILLS", "0,0,0").split(","))


def options_of(arguments: list[str]) -> tuple[dict[str, str], Path | None]:
    """Options of a call and of its script's head, and the script."""
    script = next((Path(a) for a in arguments if not a.startswith("-")), None)
    head = re.findall(r"^#SBATCH (.*)$", script.read_text(), re.MULTILINE) if script else []
    given = [*(a for line in head for a in shlex.split(line)), *(a for a in arguments if a.startswith("-"))]
    return {name: value for name, _, value in (a.partition("=") for a in given)}, script


def run_task(number: str, script: Path, log: str) -> None:
    """One task of an array, again as often as it asks to be requeued."""
    task = os.environ.get("SLURM_JOB_ID", "") + number
    dice = random.Random(f"{SEED} {script.stat().st_mtime_ns} {number}")
    for restarts in range(10):
        job = f"{task}_{restarts}"
        facts = {"SLURM_ARRAY_TASK_ID": number, "SLURM_JOB_ID": job, "SLURM_RESTART_COUNT": str(restarts)}
        with open(log.replace("%a", number), "ab") as stream:
            child = subprocess.Popen(
                ["bash", str(script)], env={**os.environ, **facts}, stdout=stream, stderr=stream, start_new_session=True
            )
            if restarts == 0 and dice.random() < SHARE:
                time.sleep(dice.uniform(0.05, SECONDS))
                kill(child, dice.choice(("job", "job", "work", "timeout")))
            child.wait()
        if not (NOTES / f"requeue-{job}").exists():
            return


def kill(child: subprocess.Popen, what: str) -> None:
    """The whole job at once; or the work alone, as the memory's limit does; or a word in time, as before a time limit."""
    if child.poll() is not None:
        return
    with (NOTES / "kills").open("a") as stream:
        stream.write(f"{what}\n")
    if what == "job":
        os.killpg(child.pid, signal.SIGKILL)
    elif what == "timeout":
        child.terminate()
    else:
        found = subprocess.run(["pgrep", "-P", str(child.pid)], capture_output=True, text=True).stdout.split()
        for pid in found[:1]:
            os.kill(int(pid), signal.SIGKILL)


def main() -> None:
    """`sbatch` or `scontrol`, by the name that this is called by."""
    arguments = sys.argv[2:]
    if sys.argv[1] == "scontrol":
        (NOTES / f"requeue-{arguments[1]}").touch()
        return
    options, script = options_of(arguments)
    number = str(1000 + len(list(NOTES.glob("job-*"))))
    (NOTES / f"job-{number}").write_text("\n".join(arguments))
    if script is None:
        with open(options["--output"], "ab") as stream:
            subprocess.run(["bash", "-c", options["--wrap"]], stdout=stream, stderr=stream)
    else:
        first, last = re.match(r"(\d+)-(\d+)", options["--array"]).groups()
        with ThreadPoolExecutor(int(os.environ.get("FAKE_SLOTS", "2"))) as pool:
            list(pool.map(lambda n: run_task(str(n), script, options["--output"]), range(int(first), int(last) + 1)))
    print(number)


main()
