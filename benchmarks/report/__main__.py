"""python -m benchmarks.report [--check]: write docs/benchmarks.md and its plots from benchmarks/results; --check only compares.

Exit status 1 with --check where the page is not what the stored results say.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from benchmarks.report.scatter import scatter
from benchmarks.report.section import Section
from benchmarks.report.sections import SECTIONS
from benchmarks.stability.page import page as stability_page
from benchmarks.stability.verdicts import Row

ROOT = Path(__file__).parents[2]
RESULTS, PAGE = ROOT / "benchmarks" / "results", ROOT / "docs" / "benchmarks.md"
PLOTS = ROOT / "docs" / "images" / "benchmarks"
HEAD = """# Error against run time

Written by `make bench` from the stored results in `benchmarks/results`; `python -m benchmarks.report` writes it again from
those alone, and a test fails where it says anything else. Both axes are logarithmic; what is ringed is the program's default.
Whether formulas, kernels and fits are stable where they are hardest is in [stability.md](stability.md).
"""


def files() -> dict[Path, str]:
    """The page and its plots, by path."""
    out: dict[Path, str] = {}
    lines = [HEAD]
    for name, make in SECTIONS.items():
        path = RESULTS / f"{name}.json"
        if path.is_file():
            stored = json.loads(path.read_text(encoding="utf-8"))
            section = make(stored)
            out |= {PLOTS / f"{plot}.svg": scatter(points, x, y) for plot, points, x, y in section.plots}
            lines += _lines(name, section, how_made(name, stored))
    stability = RESULTS / "stability.json"
    if stability.is_file():
        stored = json.loads(stability.read_text(encoding="utf-8"))
        out[PAGE.with_name("stability.md")] = stability_page([Row(**row) for row in stored["rows"]], stored)
    return {PAGE: "\n".join(lines), **{path: text for path, text in out.items() if text}}


TOLD = ("approximations", "mesh", "train", "light", "ablation")
"""Results whose sections say themselves what they were made with."""


def how_made(name: str, stored: Any) -> str:
    """On what machine and when a result was made, as far as it was kept."""
    if name in TOLD:
        return ""
    listed = stored if isinstance(stored, list) else list(stored.values()) if name == "assets" else [stored]
    kept = [row.get("made") for row in listed]
    made = sorted({f"{m['machine']}, {m['commit']}, {m['date']}" for m in kept if m})
    said = [f"Made on {'; '.join(made)}."] if made else []
    return " ".join([*said, *(["What it was made with was not kept."] if None in kept else [])])


def _lines(name: str, section: Section, made: str) -> list[str]:
    heads, *rows = section.rows
    out = [f"## {section.title}", "", f"{section.text} {made}".strip(), ""]
    out += [f"![{y} over {x}](images/benchmarks/{plot}.svg)\n" for plot, points, x, y in section.plots if points]
    out += [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads), *(f"| {' | '.join(row)} |" for row in rows), ""]
    return [*out, f"From `benchmarks/results/{name}.json`.", ""]


def main() -> int:
    """Write, or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    check = parser.parse_args().check
    stale = []
    for path, text in files().items():
        if check:
            if not path.is_file() or path.read_text(encoding="utf-8") != text:
                stale.append(path.relative_to(ROOT).as_posix())
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    if stale:
        print(f"not what benchmarks/results say: {', '.join(stale)}; run python -m benchmarks.report", file=sys.stderr)
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
