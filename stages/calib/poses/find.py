"""Cameras from pictures with COLMAP (pycolmap): features, matches, incremental mapping, one seed throughout."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.naming.exif import focal_from_exif
from pipeline.capture.naming.files import count, some
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.colmap import parameters_of, read_model
from pipeline.formats.dataset_files import POINTS
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lens import FRAMES
from stages.calib.poses.proxies import Proxy, write_masks, write_proxies
from stages.calib.poses.scale import world_scale
from stages.calib.poses.straighten import write_cameras
from stages.calib.poses.write import FRAME_SUFFIX, write_points, write_sparse

EXHAUSTIVE_VIEWS = 150
"""All pairs up to here (11 000 pairs); beyond, neighbours by name and loop closures."""
DEFAULT_FOCAL = 1.2
"""Of the longer side, COLMAP's own guess where nothing is known."""
MAX_ERROR_PX = 2.0
"""Observations further off are outliers; COLMAP's 4 px keeps many (castle: mean error 0.68 px with 4, 0.58 with 2)."""
GLOBAL_GROWTH = 1.4
"""The whole model is adjusted again when it has grown by this factor (COLMAP: 1.1); the last adjustment is global anyway."""
MIN_FEATURES = 50
MIN_VIEWS = 3
ADVICE = (
    "more overlap between neighbours, more texture in view (a printed mat under the object), sharp pictures, "
    "or cameras in transforms.json"
)


def find_cameras(stage: StageRun) -> None:
    """Find every view's camera; writes cameras.json, sparse/ and points.ply. Raises UserError with what to try."""
    capture = stage.capture
    frames = _frames(stage)
    if len(frames) < MIN_VIEWS:
        raise UserError(
            capture.root,
            f"{count(frames, 'view')} without cameras: at least {MIN_VIEWS} are needed to find them",
            "add views or cameras",
        )
    work = stage.scratch / "colmap"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    with stage.progress.bar("finding cameras", 4, "steps") as bar:
        proxies = write_proxies(stage, work / "images", frames)
        masks = write_masks(stage, work / "masks", proxies)
        bar.advance(extra="pictures written")
        session = Session(stage, work, proxies, masks)
        session.features()
        bar.advance(extra="features found")
        session.match()
        bar.advance(extra="matched")
        model = session.map()
        bar.advance(extra="cameras found")
    _finish(stage, model, proxies)


def triangulate(stage: StageRun, cameras: Mapping[str, Camera], offset: NDArray[np.float64]) -> None:
    """With given cameras by VIEW, `offset` [3] taken from their positions: sparse points alone, poses untouched."""
    work = stage.scratch / "colmap"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    frames = _frames(stage)
    proxies = write_proxies(stage, work / "images", frames)
    session = Session(stage, work, proxies, write_masks(stage, work / "masks", proxies))
    session.features(cameras)
    session.match()
    points, colours = session.triangulate(cameras)
    if len(points) < MIN_FEATURES:
        stage.warn(
            f"{stage.capture.root}: only {len(points)} points agree with the given cameras; "
            "check axis convention, pose direction (world-to-camera or back), focal length and principal point"
        )
    stage.note("points", len(points))
    if len(points):
        write_sparse(stage.output / "sparse", cameras, points, colours, FRAME_SUFFIX, offset)
        write_points(stage.output / POINTS, points, colours, offset)


class Session:
    """One COLMAP database and what is done with it."""

    def __init__(self, stage: StageRun, work: Path, proxies: list[Proxy], masks: Path | None) -> None:
        import pycolmap

        self.colmap = pycolmap
        pycolmap.logging.minloglevel = 3
        self.stage, self.work, self.proxies, self.masks = stage, work, proxies, masks
        self.images, self.database = work / "images", work / "database.db"
        self.seed = int(stage.parameters.seed)
        pycolmap.set_random_seed(self.seed)
        pycolmap.Database.open(self.database).close()

    def features(self, cameras: Mapping[str, Camera] | None = None) -> None:
        """SIFT inside the masks; every camera folder shares one set of intrinsics. Raises UserError on pictures without any."""
        pc = self.colmap
        groups: dict[str, list[Proxy]] = {}
        for proxy in self.proxies:
            groups.setdefault(proxy.group, []).append(proxy)
        options = pc.FeatureExtractionOptions(num_threads=max(1, self.stage.jobs), use_gpu=False)
        options.max_image_size = self.stage.parameters.max_size
        options.sift.max_num_features = self.stage.parameters.features
        for _, members in sorted(groups.items()):
            model, numbers = self._intrinsics(members, cameras)
            reader = pc.ImageReaderOptions(camera_model=model, camera_params=",".join(repr(float(x)) for x in numbers))
            if self.masks is not None:
                reader.mask_path = str(self.masks)
            names = sorted(p.name for p in members)
            common = {"image_names": names, "camera_mode": pc.CameraMode.PER_FOLDER}
            pc.import_images(self.database, self.images, options=reader, **common)
            pc.extract_features(self.database, self.images, reader_options=reader, extraction_options=options, **common)
        with pc.Database.open(self.database) as database:
            found = {image.name: database.num_keypoints_for_image(image.image_id) for image in database.read_all_images()}
        poor = [p.view for p in self.proxies if found.get(p.name, 0) < MIN_FEATURES]
        if len(self.proxies) - len(poor) < MIN_VIEWS:
            view = self.stage.capture.view(poor[0])
            raise UserError(
                view.paths[0], f"too few features to find cameras ({len(poor)} of {len(self.proxies)} views)", f"try {ADVICE}"
            )
        if poor:
            self.stage.warn(f"{self.stage.capture.root}: few features in {count(poor, 'view')} ({some(poor)})")

    def _intrinsics(self, members: list[Proxy], cameras: Mapping[str, Camera] | None) -> tuple[str, list[float]]:
        first = members[0]
        if cameras is not None:
            return parameters_of(cameras[first.view])
        focal = self.known_focal()
        told = (
            [f for f in (focal_from_exif(self.stage.capture.view(p.view).paths[0]) for p in members) if f]
            if focal is None
            else []
        )
        guess = focal or (float(np.median(told)) if told else DEFAULT_FOCAL * max(first.width, first.height))
        return "SIMPLE_RADIAL", [guess, first.width / 2, first.height / 2, 0.0]

    def known_focal(self) -> float | None:
        """A focal length that is kept as told."""
        return self.stage.parameters.focal_px or self.stage.capture.config.poses.focal_px

    def match(self) -> None:
        """Pairs of pictures: all, or neighbours by name."""
        pc = self.colmap
        matching = pc.FeatureMatchingOptions(use_gpu=False, num_threads=max(1, self.stage.jobs))
        verification = pc.TwoViewGeometryOptions()
        verification.ransac.random_seed = self.seed
        method = self.stage.parameters.matching
        if method == "auto":
            method = "exhaustive" if len(self.proxies) <= EXHAUSTIVE_VIEWS else "sequential"
        pc.set_random_seed(self.seed)
        if method == "exhaustive":
            pc.match_exhaustive(self.database, matching_options=matching, verification_options=verification)
        else:
            pairing = pc.SequentialPairingOptions(overlap=12, quadratic_overlap=True)
            pc.match_sequential(
                self.database, matching_options=matching, pairing_options=pairing, verification_options=verification
            )
        self.stage.note("matching", method)

    def mapping_options(self) -> Any:
        """Incremental mapping with every seed set."""
        options = self.colmap.IncrementalPipelineOptions()
        options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = self.seed
        options.num_threads = 1  # sums over threads in another order give other last digits
        options.mapper.filter_max_reproj_error = MAX_ERROR_PX
        options.ba_global_frames_ratio = options.ba_global_points_ratio = GLOBAL_GROWTH
        refine = self.stage.parameters.refine_focal and self.known_focal() is None
        options.ba_refine_focal_length = refine
        return options

    def map(self) -> Any:
        """The largest reconstruction. Raises UserError when there is none."""
        pc = self.colmap
        (self.work / "sparse").mkdir(exist_ok=True)
        pc.set_random_seed(self.seed)
        models = pc.incremental_mapping(self.database, self.images, self.work / "sparse", options=self.mapping_options())
        pc.logging.minloglevel = 3  # bundle adjustment sets it back
        if not models:
            background = "" if self.masks is not None else "; on a turntable give masks, as the still background matches itself"
            raise UserError(
                self.stage.capture.root, f"COLMAP found no cameras for {len(self.proxies)} views", f"try {ADVICE}{background}"
            )
        best = max(models.values(), key=lambda m: (m.num_reg_images(), m.num_points3D()))
        if len(models) > 1:
            sizes = sorted((m.num_reg_images() for m in models.values()), reverse=True)
            self.stage.warn(
                f"{self.stage.capture.root}: the views fall into {len(models)} parts of {sizes}; "
                f"the largest is kept. Try {ADVICE}"
            )
        return self.with_rig(best)

    def with_rig(self, model: Any) -> Any:
        """Two cameras with pictures of equal names are a head: one relative pose for all pairs, adjusted together."""
        prefixes = self.rig_prefixes()
        registered = {model.images[i].name for i in model.reg_image_ids()}
        if not prefixes or not all(any(name.startswith(p) for name in registered) for p in prefixes):
            return model
        pc = self.colmap
        cameras = [pc.RigConfigCamera(ref_sensor=i == 0, image_prefix=prefix) for i, prefix in enumerate(prefixes)]
        with pc.Database.open(self.database) as database:
            pc.apply_rig_config([pc.RigConfig(cameras=cameras)], database, model)
        options = pc.BundleAdjustmentOptions()
        options.refine_focal_length = options.refine_extra_params = self.mapping_options().ba_refine_focal_length
        options.print_summary = False
        options.ceres.min_num_residuals_for_cpu_multi_threading = 1 << 30  # one order of summation
        pc.bundle_adjustment(model, options)
        pc.logging.minloglevel = 3  # bundle adjustment sets it back
        model.update_point_3d_errors()
        self.stage.note("rig", list(prefixes))
        return model

    def rig_prefixes(self) -> tuple[str, ...]:
        """The picture folders of a two-camera head, or nothing."""
        stems: dict[str, set[str]] = {}
        for proxy in self.proxies:
            stems.setdefault(f"{proxy.group}/", set()).add(Path(proxy.name).name)
        if self.stage.parameters.rig != "auto" or len(stems) != 2 or len({frozenset(s) for s in stems.values()}) != 1:
            return ()
        return tuple(sorted(stems))

    def triangulate(self, cameras: Mapping[str, Camera]) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Points [N, 3] and colours seen from fixed cameras."""
        pc = self.colmap
        view_of = {p.name: p.view for p in self.proxies}
        model = pc.Reconstruction()
        with pc.Database.open(self.database) as database:
            for camera in database.read_all_cameras():
                model.add_camera_with_trivial_rig(camera)
            for image in database.read_all_images():
                pose = cameras[view_of[image.name]].world_to_camera
                rigid = pc.Rigid3d(pc.Rotation3d(pose[:3, :3]), pose[:3, 3])
                bare = pc.Image(name=image.name, camera_id=image.camera_id, image_id=image.image_id)
                model.add_image_with_trivial_frame(bare, rigid)
        (self.work / "points").mkdir(exist_ok=True)
        options = self.mapping_options()
        options.ba_refine_focal_length = options.ba_refine_extra_params = False
        model = pc.triangulate_points(model, self.database, self.images, self.work / "points", options=options)
        return _points(model)


def _points(model: Any) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    items = sorted(model.points3D.items())
    xyz = np.array([p.xyz for _, p in items]).reshape(-1, 3)
    return xyz, np.array([p.color for _, p in items], np.uint8).reshape(-1, 3)


def _by_view(sparse: Path) -> dict[str, Camera]:
    """The cameras of a model whose images are named as frames."""
    return {name.removesuffix(FRAME_SUFFIX): camera for name, camera in read_model(sparse).cameras.items()}


def _finish(stage: StageRun, model: Any, proxies: list[Proxy]) -> None:
    """Name images by VIEW, fix the scale, write; say what was not registered."""
    view_of = {p.name: p.view for p in proxies}
    camera_of = {p.view: p.camera for p in proxies}
    registered = sorted(view_of[model.images[i].name] for i in model.reg_image_ids())
    lost = sorted(set(camera_of) - set(registered))
    if lost:
        stage.warn(
            f"{stage.capture.root}: no camera found for {count(lost, 'view')} ({some(lost)}): they are left out. Try {ADVICE}"
        )
    error = float(model.compute_mean_reprojection_error())
    for image_id in model.reg_image_ids():
        model.images[image_id].name = view_of[model.images[image_id].name] + FRAME_SUFFIX
    sparse = stage.output / "sparse"
    sparse.mkdir()
    model.write_text(str(sparse))
    cameras = _by_view(sparse)
    config = stage.capture.config
    pictures = {p.view: stage.scratch / "colmap" / "images" / p.name for p in proxies}
    scale = world_scale(config.poses, cameras, pictures, config.path or stage.capture.root)
    if scale != 1.0:
        model.transform(stage_similarity(scale))
        model.write_text(str(sparse))
        cameras = _by_view(sparse)
        stage.note("scale", scale)
    write_cameras(stage, {v: replace(c, name=camera_of[v]) for v, c in cameras.items()})
    points, colours = _points(model)
    write_points(stage.output / POINTS, points, colours)
    focal = {camera_of[v]: c.fx for v, c in cameras.items()}
    summary = {"registered": len(registered), "views": len(camera_of), "mean_reprojection_error_px": error,
               "points": len(points), "focal_px": focal, "left_out": lost}  # fmt: skip
    for key, value in summary.items():
        stage.note(key, value)
    stage.progress.say(f"{len(registered)} of {len(camera_of)} cameras found, mean reprojection error {error:.2f} px")


def stage_similarity(scale: float) -> Any:
    """A scaling of the world about its origin."""
    import pycolmap

    return pycolmap.Sim3d(scale, pycolmap.Rotation3d(), np.zeros(3))


def _frames(stage: StageRun) -> dict[str, dict]:
    return json.loads((stage.inputs["decode"] / FRAMES).read_text(encoding="utf-8"))["views"]
