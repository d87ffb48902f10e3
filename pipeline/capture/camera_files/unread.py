"""Camera files of programs that nobody here reads: named, with the way out."""

from __future__ import annotations

from pathlib import Path

COLMAP_WAY = "export a COLMAP model (sparse/0) or transforms.json from it"
PATTERNS = (
    ("*.psx", "a Metashape project", "export its cameras as cameras.xml (File > Export > Export Cameras)"),
    ("*.psz", "a Metashape project", "export its cameras as cameras.xml (File > Export > Export Cameras)"),
    ("*.rcproj", "a RealityCapture project", COLMAP_WAY),
    ("*.nvm", "a VisualSFM model", "`colmap model_converter` does not read it: export Bundler's bundle.out from VisualSFM"),
    ("sfm_data.json", "an OpenMVG scene", COLMAP_WAY + " (openMVG_main_openMVG2Colmap)"),
    ("sfm_data.bin", "an OpenMVG scene", COLMAP_WAY + " (openMVG_main_openMVG2Colmap)"),
    ("*.sfm", "a Meshroom scene", COLMAP_WAY + " (Meshroom's ExportColmap)"),
    ("reconstruction.json", "an OpenSfM reconstruction", COLMAP_WAY + " (bin/export_colmap)"),
    ("*calibrated_camera_parameters.txt", "Pix4D camera parameters", COLMAP_WAY),
    ("*calibrated_external_camera_parameters.txt", "Pix4D camera parameters", COLMAP_WAY),
    ("*_cam.txt", "MVSNet camera files", COLMAP_WAY),
    ("*_KRT.txt", "KRT camera files", COLMAP_WAY),
    ("cam_dict_norm.json", "NeRF++ cameras", "convert them to transforms.json"),
    ("intrinsics.txt", "a camera file (intrinsics.txt)", "convert it and its poses to transforms.json"),
    ("traj.txt", "a trajectory", "convert it to transforms.json"),
    ("cameras.json", "a cameras.json", "rename it transforms.json if it is nerfstudio's"),
)


def unread(folders: list[Path]) -> list[str]:
    """A line for each camera file in the folders that is known and not read."""
    found: dict[str, str] = {}
    for folder in folders:
        for pattern, what, way in PATTERNS:
            path = next((p for p in sorted(folder.glob(pattern)) if not p.name.startswith(".")), None)
            if path is not None:
                found.setdefault(what, f"{path}: {what} is not read and the cameras are found anew; to use it, {way}")
    return list(found.values())
