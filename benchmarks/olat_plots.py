"""Pictures of the olat benchmark: run time against gradient norm, errors against the number of lights."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stages.olat.zoo.solvers import library

QUANTITIES = ("n_d", "rho_d", "n_s", "rho_s", "sigma")
UNITS = {"n_d": "$n_d$", "rho_d": r"$\rho_d$", "n_s": "$n_s$", "rho_s": r"$\rho_s$", "sigma": r"$\sigma$"}
MARKERS = {"jaxopt": "o", "optimistix": "^", "optax": "s"}
FLOOR = 1e-12  # smallest norm drawn: a log axis has no 0


def plot_solvers(record: dict[str, Any], path: Path) -> None:
    """One panel a quantity: seconds a pixel against gradient norm.

    Ours are stars, jaxopt's dots, optimistix's triangles, optax's squares, PRF's on its GPU crosses.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import NullFormatter

    figure, axes = plt.subplots(1, 5, figsize=(20, 4.4), sharey=True)
    colours = {name: f"C{k % 9 + 1}" for k, name in enumerate(record["theirs"])}
    for axis, quantity in zip(axes, QUANTITIES):
        ours = record["ours"][quantity]
        axis.loglog(ours["seconds"], max(ours["gradient"], FLOOR), "*", color="k", ms=15, label="ours (closed), one thread")
        double = record["ours"].get(f"{quantity}_float64")
        if double:
            axis.loglog(double["seconds"], max(double["gradient"], FLOOR), "*", mfc="w", mec="k", ms=13, label="ours, float64")
        for name, cells in record["theirs"].items():
            if quantity in cells:
                cell = cells[quantity]
                axis.loglog(
                    cell["seconds"],
                    max(cell["gradient"], FLOOR),
                    MARKERS[library(name)],
                    color=colours[name],
                    label=name if name.startswith(library(name)) else f"jaxopt {name}",
                )
        for name, published in record["published"].items():
            if quantity in published:
                axis.loglog(
                    *published[quantity], "x", color=colours.get(name, "0.6"), label="PRF, A6000" if name == "gd" else None
                )
        axis.set_title(UNITS[quantity])
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.set_xlim(3e-7, 1e-2)
        axis.set_xlabel("seconds a pixel")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("gradient norm at the end")
    handles, names = axes[1].get_legend_handles_labels()
    figure.legend(handles, names, loc="lower center", ncol=(len(names) + 1) // 2, frameon=False)
    figure.tight_layout(rect=(0, 0.12, 1, 1))
    figure.savefig(path, dpi=100)


def plot_lights(rows: list[dict[str, float]], path: Path) -> None:
    """Median errors against the number of lights."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(6, 4))
    labels = {
        "n_d_deg": "$n_d$ (deg)",
        "n_s_deg": "$n_s$ (deg)",
        "sigma_rel": r"$\sigma$ (relative)",
        "rho_d_rel": r"$\rho_d$ (relative)",
    }
    for name, label in labels.items():
        axis.loglog([row["lights"] for row in rows], [row[name] for row in rows], "o-", label=label)
    axis.loglog([row["lights"] for row in rows], [max(row["flagged"], 1e-4) for row in rows], "k:", label="flagged (share)")
    axis.set_xlabel("lights")
    axis.set_ylabel("median error")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=100)
