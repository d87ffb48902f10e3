"""What the page says of each stored result: a title, how it is run, points to plot and rows to print."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmarks.report.scatter import Point
from benchmarks.report.section import Section, number
from benchmarks.report.whole_runs import ablation, assets


def decode(stored: dict[str, Any]) -> Section:
    """Every way to a Stokes image."""
    points, rows = [], [["method", "DoLP, RMS error", "s a megapixel", "default"]]
    for name, row in stored["error"].items():
        own = "carriers" in name or name == "stack 0 45 90 135"
        points.append(Point("both captures", name, row["s_per_mpx"], row["dolp_rmse"], own))
        rows.append([name, number(row["dolp_rmse"]), number(row["s_per_mpx"]), "yes" if own else ""])
    text = (
        "Mosaics and angle stacks made from captures with known Stokes vectors, with sensor noise, and solved by each method."
    )
    return Section("Decode", text, rows, [("decode", points, "seconds a megapixel", "DoLP, RMS error")])


def masks(stored: list[dict[str, Any]]) -> Section:
    """Every way to an object's mask."""
    points, rows = [], [["capture", "method", "IoU, mean", "IoU, least", "processor time, s a view"]]
    for row in stored:
        own = row["method"] in ("all views together", "matte")
        points.append(Point(row["capture"], row["method"], row["s_per_view"], 1 - row["iou_mean"], own))
        figures = (row["iou_mean"], row["iou_min"], row["s_per_view"])
        rows.append([row["capture"], row["method"], *(number(f) for f in figures)])
    return Section(
        "Masks", "Segmentation against known masks, with a background put behind the object.", rows,
        [("masks", points, "processor seconds a view", "1 - IoU")],
    )  # fmt: skip


def poses(stored: dict[str, Any]) -> Section:
    """Cameras from photographs alone."""
    rows = [["features found at", "registered", "reprojection error, px", "focal length off, %", "s"]]
    points = []
    for name, row in stored.items():
        if isinstance(row, dict) and name != "made":
            off = max(map(abs, row.get("focal_error_pct", [float("nan")])))
            rows.append(
                [
                    name,
                    f"{row['registered']} of {row['views']}",
                    number(row["reprojection_error_px"]),
                    number(off),
                    number(row["poses_s"]),
                ]
            )
            points.append(Point("photographs", name, row["poses_s"], off, name == "ours"))
    text = "Structure from motion on 11 photographs whose focal length is known."
    return Section("Poses", text, rows, [("poses", points, "seconds", "focal length, % off")])


def olat(stored: dict[str, Any]) -> Section:
    """Light-stage fits: solvers, lights, forms."""
    points = [Point("closed forms", q, row["seconds"], row["gradient"], True) for q, row in stored["ours"].items()]
    for solver, quantities in stored["theirs"].items():
        points += [Point(solver, q, row["seconds"], row["gradient"]) for q, row in quantities.items()]
    points += [
        Point("published (A6000)", f"{s} {q}", t, g) for s, row in stored["published"].items() for q, (t, g) in row.items()
    ]
    rows = [["solver", "quantity", "s a pixel", "gradient at the end"]]
    rows += [[p.series, p.label, number(p.time), number(p.error)] for p in points if not p.series.startswith("published")]
    forms = [
        Point(row["pixels"], row["form"], 1 / row["px_per_s"], row["n_d_mean_deg"], row["form"] == "default")
        for row in stored["forms"] if row.get("px_per_s") and row.get("n_d_mean_deg")
    ]  # fmt: skip
    speed = stored["speed"]
    text = (
        f"PRF's Table 3 rerun: the gradient's norm where a solver ends, against its seconds. The whole chain: "
        f"{number(speed['pixels_per_s'])} pixels a second, {speed['lights']} lights, {speed['threads']} threads, "
        f"{number(speed['peak_rss_mb'])} MB."
    )
    if full := stored.get("full"):
        few, most = full["runs"][0], full["runs"][-1]
        text += (
            f" One camera of {full['width']} x {full['height']} with {full['pixels']} pixels in the mask: "
            f"{number(few['peak_rss_mb'])} MB under {few['lights']} lights, {number(most['peak_rss_mb'])} MB under "
            f"{most['lights']}; {number(full['cpu_s_a_frame'])} s of one core a frame, its fits included, and "
            f"{number(full['cpu_s_besides'])} s to write the maps ({full['machine']}, {full['commit']}, {full['date']})."
        )
    return Section(
        "Light-stage fits", text, rows,
        [
            ("olat-solvers", points, "seconds a pixel", "gradient norm at the end"),
            ("olat-forms", forms, "seconds a pixel", "diffuse normal, mean error (degrees)"),
        ],
    )  # fmt: skip


def overexposure(stored: dict[str, Any]) -> Section:
    """Light-stage fits of clipped samples: PRF's removal against bounds."""
    heads = (
        "pixels", "twice over", "clipped", "way", "light taken away, %", "specular albedo off, %", "width off, %",
        "specular normal, degrees", "diffuse normal, degrees", "diffuse albedo off, %",
    )  # fmt: skip
    rows = [list(heads)]
    points = []
    for row in stored["rows"]:
        off = [100 * row[name] for name in ("removed", "rho_s_rel", "sigma_rel")]
        figures = [*off, row["n_s_deg"], row["n_d_deg"], 100 * row["rho_d_rel"]]
        shown = number(100 * row["clipped_pixels"]) + " %"
        rows.append([row["pixels"], row["deep"], shown, row["way"], *(number(value) for value in figures)])
        label = f"{row['way']}, {row['deep']}"
        points.append(Point(row["pixels"], label, row["seconds_per_pixel"], off[1], row["way"] == "bounds"))
    text = (
        "PRF's ablation of its overexposure removal (Algorithm 1) against truth: light stages clipped at half of what the "
        "brightest pixels reach, of which there are as many as `twice over` says; medians over the pixels that are clipped. "
        "`bounds` is the program's own way (a clipped sample bounds the lobe from below), M = 0 takes samples as they are, "
        "epsilon is 0.1 where none is named. Pictures: `benchmarks/results/overexposure.png`, of each way the specular albedo, "
        "then of each the diffuse one, then ten times the share of light taken away."
    )
    return Section(
        "Overexposed highlights", text, rows, [("overexposure", points, "processor seconds a pixel", "specular albedo off (%)")]
    )


def rasterize(stored: dict[str, Any]) -> Section:
    """The rasteriser against its float64 reference."""
    rows = [["backend", "forward, ms", "forward and backward, ms"]]
    for name in ("cpu", "cpu_as_in_training", "cpu_612x512_100k", "reference"):
        row = stored.get(name, {})
        both = row.get("forward_backward_ms", {}).get("median")
        rows.append([name.replace("_", " "), number(row.get("forward_ms", {}).get("median")), number(both)])
    text = (
        f"{number(stored['times_reference_forward_backward'])} times as fast as the readable float64 reference; largest "
        f"relative difference {number(max(stored['relative_difference'].values()))}. {stored['machine']}, "
        f"torch {stored['torch']}."
    )
    return Section("Rasteriser", text, rows, [])


def train(stored: dict[str, Any]) -> Section:
    """Training: error over seconds as it goes, and what each piece buys."""
    points, rows = [], [["capture", "run", "steps", "s", "PSNR, object, dB", "normals, degrees", "environment, dB"]]
    for capture, runs in stored["captures"].items():
        for name, run in runs.items():
            last = run["curve"][-1]
            figures = (last["train_s"], last.get("psnr_foreground"), last.get("normal_mae_deg"), last.get("env_psnr"))
            rows.append([capture, name, str(last["iteration"]), *(number(f) for f in figures)])
            if name in ("stokes", "polarisers", "none"):
                points += [
                    Point(f"{capture}, {name}", f"{row['iteration']} steps", row["train_s"], row["normal_mae_deg"], row is last)
                    for row in run["curve"] if row.get("normal_mae_deg")
                ]  # fmt: skip
    then = ", ".join(f"{name} {a} then, {b} now" for name, (a, b) in stored.get("defaults_since", {}).items())
    text = "Normals of held-back views while training goes on, and runs with one piece changed."
    if then:
        text += f" Made with other defaults than today's: {then}."
    return Section("Training", text, rows, [("train", points, "seconds of training", "normals, mean error (degrees)")])


def shading(stored: dict[str, Any]) -> Section:
    """The fused kernels, and what the prefiltered levels are off."""
    rows = [["what", "processor time, ms", "median error, %", "95th percentile, %"]]
    for name, value in stored["speed"].items():
        what, _, unit = name.rpartition("_")
        rows.append([what, number(1e3 * value if unit == "s" else value), "", ""])
    for name, value in stored["prefilter against quadrature"].items():
        rows.append([name, "", number(value["median_pct"]), number(value["p95_pct"])])
    text = (
        "Prefiltering and shading, forward and backward, on all threads together; the levels against sums over the same cube "
        "cut three times finer, under a made sky with a sun of half a degree."
    )
    return Section("Shading kernels", text, rows)


GROUPS = ("Fresnel", "split sum", "mirrored light", "diffuse light", "occlusion")


def approximations(stored: dict[str, Any]) -> Section:
    """What the shading leaves exact and what not."""
    points, rows = [], [["what", "how", "error", "processor time, s", "default"]]
    for name, case in stored["cases"].items():
        group, _, how = name.partition(", ")
        points.append(Point(group, how, case["seconds"], case["error"], case["default"]))
        figures = (number(case["error"]), f"{number(case['seconds'])} {case['unit']}")
        rows.append([group, how, *figures, "yes" if case["default"] else ""])
    made = sorted({f"{case['machine']}, {case['commit']}, {case['date']}" for case in stored["cases"].values()})
    text = (
        "Each against a converged reference. Fresnel: largest relative error of the reflectance at an index of 1.5, float32. "
        "Split sum: 95th percentile of the albedo's relative error between nodes. Mirrored (roughness 0.3) and diffuse light: "
        "median relative error under a sky with a sun of half a degree. Occlusion: RMS error of the share of an even sky that "
        f"a torus leaves to itself, before neighbours are averaged. Measured on {'; '.join(made)}."
    )
    plots = [
        (f"approximations-{group.replace(' ', '-').lower()}", own, f"processor seconds {units[0]}", "error")
        for group in GROUPS
        if (own := [p for p in points if p.series == group])
        and (units := [c["unit"] for n, c in stored["cases"].items() if n.startswith(group)])
    ]
    return Section("Approximations of the shading", text, rows, plots)


def mesh(stored: dict[str, Any]) -> Section:
    """Voxels of the fused surface, depths of the Poisson surface."""
    points, rows = [], [["depths", "surface", "chamfer distance, %", "processor time, s", "triangles", "default"]]
    for name, case in stored["cases"].items():
        depths, _, how = name.partition(", ")
        points.append(Point(depths, how, case["seconds"], case["chamfer_pct"], case["default"]))
        figures = (number(case["chamfer_pct"]), number(case["seconds"]), str(case["triangles"]))
        rows.append([depths, how, *figures, "yes" if case["default"] else ""])
    made = sorted({f"{case['machine']}, {case['commit']}, {case['date']}" for case in stored["cases"].values()})
    text = (
        "A vase seen by 24 views of 128 px, its depths as they are and with noise of half a pixel's footprint, as one surface "
        "without textures; the distance has the spacing of 100 000 samples in it, about 0.25 %. Measured on "
        f"{'; '.join(made)}."
    )
    return Section("Mesh", text, rows, [("mesh", points, "processor seconds", "chamfer distance (%)")])


def light(stored: dict[str, Any]) -> Section:
    """Light that the object hides from and sends to itself: every way to have it."""
    points, rows = [], [["capture", "way", "s0, mean error, %", "PSNR of the object, dB", "s for the mesh", "ms a view"]]
    for capture, found in stored["captures"].items():
        for name, choice in found["choices"].items():
            lights = choice["lights"].values()
            error = sum(row["s0_mean_pct"] for row in lights) / len(lights)
            level = sum(row["foreground_psnr_db"] for row in lights) / len(lights)
            points.append(Point(capture, name, choice["ms_per_view"] / 1e3, error, name == "traced"))
            rows.append([capture, name, *(number(v) for v in (error, level, choice["mesh_s"], choice["ms_per_view"]))])
    text = (
        "Relit images of the true mesh and material against renderings, means over the maps; what each way does to training, "
        f"and pictures, are in [light.md](light.md). Maps as cubes of {stored['settings']['cube']} texels, "
        f"{stored['settings']['mirror']} for what is mirrored."
    )
    return Section("Relighting", text, rows, [("light", points, "seconds a view", "s0, mean error (%)")])


SECTIONS: dict[str, Callable[[Any], Section]] = {
    "approximations": approximations, "decode": decode, "masks": masks, "poses": poses, "rasterize": rasterize, "olat": olat,
    "shading": shading, "train": train, "mesh": mesh, "light": light, "ablation": ablation, "assets": assets,
    "overexposure": overexposure,
}  # fmt: skip
"""By the name of the stored result."""
