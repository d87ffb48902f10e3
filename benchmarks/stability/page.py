"""docs/stability.md from the stored rows: the verdict first, failures by name, then every part's table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.stability.verdicts import Row

TITLES = {
    "functions": (
        "Functions of the optics",
        "Against 60-digit arithmetic over a stiff grid (cosine 2e-6 to 1, Brewster's angle and beside it, eta from 1, "
        "alpha from 1e-6, Stokes vectors from 1e-37 to 1e30) and 400 random points. *value*: largest error, of the "
        "value itself (beside a zero, of 0.1); sound: 1e-5 in float32, 1e-12 in float64, gradients finite. *absolute*: "
        "the largest in the value's own units. *ns*: an element, one thread.",
    ),
    "kernels": (
        "Kernels against their definitions",
        "float32 kernels against readable float64 code. *value*: of the point's (image's) largest component; "
        "*gradient*: 99th percentile, of the largest of its argument (rasteriser: largest). The tree of light is cut at"
        " thresholds: two precisions may sum over other leaves.",
    ),
    "light stage": (
        "Light-stage fits",
        "200 pixels of known truth a setting, the lobe chosen as the stage chooses it. *wrong*: share of the pixels "
        "flagged good whose normal is off by more than 5 degrees, or a width or the specular albedo by more than half; "
        "sound: at most 1 %. Medians of the good ones in degrees and relative.",
    ),
    "whole runs": (
        "Whole runs",
        "`make all` on captures of 64 pixels and 200 steps: whether they end, not how good they are. Sound: ends (or, "
        "where nothing can be made, refuses in one line), every value written is finite, a warning says what the model "
        "cannot explain, the same capture in other units gives the same, and nothing is wrong without a word: the true surface "
        "more than a pixel (2 %) off where a view sees it, or unseen views at twice the base's error. *surface_pct*: median "
        "distance of the true surface, where it is seen, from the mesh, in percent of its size.",
    ),
    "options": (
        "Every option of the light stage",
        "A small light stage through the olat stage under every value of every option, relit from its maps. Sound: it ends, "
        "every value is finite, `maps.json` names the lobe that was fitted, and the picture is neither darker than half of the "
        "default's nor has peaks of four times its. *relit_peak*: 99.9th percentile.",
    ),
    "repeats": ("The same bytes twice", "Files of every stage, but for logged seconds."),
}


def _number(value: Any) -> str:
    if isinstance(value, str):
        return value
    if value != value:
        return ""  # no such figure
    if isinstance(value, int) or (value == int(value) and abs(value) < 1e6):
        return str(int(value))
    return f"{value:.2g}"


def _table(rows: Sequence[Row]) -> list[str]:
    columns = list(dict.fromkeys(k for row in rows for k in row.figures))
    lines = [f"| | | {' | '.join(columns)} | worst at | verdict |", "|" + "---|" * (len(columns) + 4)]
    for row in rows:
        cells = [_number(row.figures[c]) if c in row.figures else "" for c in columns]
        verdict = "sound" if row.sound else "**FAILS**"
        lines.append(f"| {row.name} | {row.setting} | {' | '.join(cells)} | {row.worst} | {verdict} |")
    return lines


def _run_at(rows: Sequence[Row]) -> str:
    """Of which commit the program was that the rows tried."""
    commits: dict[str, int] = {}
    for row in rows:
        commits[row.commit] = commits.get(row.commit, 0) + 1
    if len(commits) == 1:
        return f"Commit {next(iter(commits))}."
    return f"Commits {', '.join(f'{commit} ({count} of {len(rows)})' for commit, count in commits.items())}."


def _time(cpu_s: Mapping[str, float]) -> str:
    """What the parts took, where all were run to their end in one go."""
    if set(cpu_s) != set(TITLES):
        return ""
    parts = ", ".join(f"{TITLES[part][0].lower()} {cpu_s[part]:.0f}" for part in TITLES)
    return f" All of it takes {sum(cpu_s.values()) / 60:.0f} minutes of one core ({parts} seconds)."


def page(rows: Sequence[Row], stamp: Mapping[str, Any]) -> str:
    """The page as Markdown; stamp: the machine, the date, which parts were `finished`, and their `cpu_s`."""
    failed = [row for row in rows if not row.sound]
    lines = [
        "# Stability: stiff and extreme cases", "",
        f"Written by `make stability`, which exits with 1 on a failure: {len(rows)} cases, **{len(failed)} fail**. "
        f"{stamp['machine']}; {stamp['date']}.{_time(stamp.get('cpu_s', {}))}", "",
    ]  # fmt: skip
    open_parts = [title for part, (title, _) in TITLES.items() if part not in stamp.get("finished", {})]
    if open_parts:
        lines += [f"Not run to their end, and so not judged as a whole: {', '.join(open_parts).lower()}.", ""]
    if failed:
        lines += ["## What fails", ""]
        lines += [f"- {row.part}: {row.name}, {row.setting}: {row.why or 'beyond its bar'}" for row in failed] + [""]
    for part, (title, text) in TITLES.items():
        own = [row for row in rows if row.part == part]
        if own:
            lines += [f"## {title}", "", f"{text} {_run_at(own)}", "", *_table(own), ""]
    told = [(row.name, line) for row in rows for line in row.warnings]
    if told:
        lines += ["### What the whole runs warned of", "", *(f"- {name}: {line}" for name, line in told), ""]
    return "\n".join(lines)
