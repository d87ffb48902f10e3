"""How one view is read from its files, once somebody wants its pixels: a closure for each kind of group."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.angle_stack.solve import design_covariance, polariser_design
from pipeline.capture.config import CaptureConfig
from pipeline.capture.model import DecodedView
from pipeline.capture.mosaic.order import order_fault
from pipeline.capture.mosaic.sensor_files import read_mosaic
from pipeline.capture.naming.grouping import Group
from pipeline.capture.pixels.brackets import read_exposures
from pipeline.capture.pixels.linear_image import balance
from pipeline.capture.pixels.stokes_files import finished, is_verbatim, mended
from pipeline.capture.pixels.stokes_frame import apply_stokes_config
from pipeline.errors import UserError

NO_CARRIERS = (
    "mosaic.order has no crossed polarisers on the diagonals: each angle is interpolated on its own, less exactly; check "
    "that it is the sensor's"
)


def colour_loader(group: Group, config: CaptureConfig) -> Callable[[], DecodedView]:
    """How a plain picture, or its exposure bracket, is read."""

    def load() -> DecodedView:
        image = read_exposures(group.angles[None], config.radiometry, view=group.view)
        rgb = np.ascontiguousarray(image.rgb(group.paths[0]))
        balance(rgb, config.radiometry)
        view = finished(DecodedView(rgb=rgb, saturated=image.saturated, alpha=image.alpha), group.paths[0], image)
        if len(group.paths) == 1 and is_verbatim(view, image, group.paths[0], ("R", "G", "B"), config):
            view.verbatim = group.paths[0]
        return view

    return load


def stack_loader(group: Group, config: CaptureConfig, camera: str) -> Callable[[], DecodedView]:
    """How an angle stack is read."""

    def load() -> DecodedView:
        from pipeline.capture.angle_stack.reader import read_stack

        return read_stack(group, config, config.polarisers.get(camera))

    return load


def mosaic_loader(group: Group, config: CaptureConfig, colour: str) -> Callable[[], DecodedView]:
    """How a polariser mosaic is read; colour: "mono" or "bayer"."""

    def load() -> DecodedView:
        from pipeline.capture.mosaic.carriers import carries
        from pipeline.capture.mosaic.demosaic import demosaic

        path = group.paths[0]
        image = read_mosaic(group, config)
        image.saturated, faults = mended(image.pixels, image.saturated, path)  # a hole would spread over its windows
        samples = image.pixels[..., 0]
        block = 4 if colour == "bayer" else 2
        if samples.shape[0] % block or samples.shape[1] % block:
            raise UserError(
                path,
                f"{samples.shape[1]}x{samples.shape[0]} are no whole {block}x{block} polariser blocks",
                "crop to whole blocks, or is it no mosaic?",
            )
        polariser = config.polarisers.get("camera")  # a mosaic's one physical camera
        extinction = polariser.extinction if polariser else None
        stokes = demosaic(samples, config.mosaic.order, colour, config.mosaic.bayer, config.mosaic.demosaic, extinction)
        balance(stokes, config.radiometry)
        stokes = apply_stokes_config(stokes, config.stokes)
        design = polariser_design(config.mosaic.order, extinction)
        view = DecodedView(
            stokes=stokes, saturated=_block_any(image.saturated), alpha=image.alpha, design=design,
            covariance=design_covariance(design),
        )  # fmt: skip
        fault = order_fault(samples, config.mosaic.order)
        if not fault and config.mosaic.demosaic == "carriers" and not carries(config.mosaic.order):
            fault = NO_CARRIERS
        if fault:
            view.faults[fault] = 0
        view.faults |= faults
        return finished(view, path, image, whole=True)

    return load


def _block_any(saturated: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A saturated sample invalidates every pixel that uses it: its neighbours within two pixels."""
    from scipy.ndimage import binary_dilation

    return binary_dilation(saturated, iterations=2, structure=np.ones((3, 3), bool)) if saturated.any() else saturated
