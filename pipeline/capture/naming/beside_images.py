"""What lies beside a capture's images: folders of masks, truth, light, models and clean plates, by name."""

from __future__ import annotations

from pathlib import Path

from pipeline.capture.naming.files import IMAGE_FOLDERS, OLAT, list_images
from pipeline.capture.recognition.stray_files import folder_of_products

PLATES = ("clean_plate", "clean_plates", "background", "backgrounds")
OTHER = frozenset({"masks", "mask", "gt", "envmaps", "sparse", "colmap", OLAT, *PLATES})


def outside_images(path: Path) -> bool:
    """Whether a folder's name says that it holds no pictures of views."""
    return path.name.lower() in OTHER and path.name not in IMAGE_FOLDERS


def is_beside(path: Path, root: Path) -> bool:
    """Whether a file below a capture without image folder lies where no views do, or is a clean plate."""
    return path.stem in PLATES or any(outside_images(p) for p in path.parents if p != root and p.is_relative_to(root))


def images_by_name(root: Path, folder: Path) -> list[Path]:
    """The pictures below the image folder among which a camera's may be looked for by their names alone.

    Masks, maps and previews bear the names of their views: where the views are gone, they would stand in for them.
    """
    found = list_images(folder)
    if folder != root:
        return found
    return [p for p in found if not is_beside(p, root) and not folder_of_products(p, root)]
