"""Structure from motion with pycolmap, in steps that resume where they were interrupted.

A database holds keypoints and matches; photos and pairs in it are not computed again. Global
mapping comes first, for it takes a tenth of the time; if it places too few photos, incremental
mapping is tried and the better model kept.
"""

import importlib
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gsynopsis.capture.matching import Matching, Pair, first_pairs, transitive_pairs
from gsynopsis.capture.photo_set import FEWEST, Photo, PhotoSet, Tick, view_folder
from gsynopsis.capture.upright import upright
from gsynopsis.errors import MissingExtraError, SceneError
from gsynopsis.interrupt import held_signals
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.colmap.distortion import Warp, lens_of
from gsynopsis.scene.spheres import Cut

LensModel = Literal["OPENCV", "SIMPLE_RADIAL", "OPENCV_FISHEYE", "PINHOLE"]
"""Camera models that can be estimated."""
Mapper = Literal["auto", "global", "incremental"]
FEATURES = 8192
"""Most keypoints of a photo."""
CHUNK = 4
"""Photos at a time."""
PAIR_CHUNK = 64
"""Pairs at a time."""
FEW = 5
"""A camera with fewer photos than this gets the simplest lens: more parameters would run away."""
GOOD_SHARE = 0.8
"""Share of the photos that global mapping must place for incremental mapping not to be tried."""
JPEG_QUALITY = 95
SEED = 0
OVERLAP = (
    "neighbouring photos must overlap by two thirds, be sharp and show texture; take more photos "
    "between those that fail, keep zoom fixed, and leave out mirrors and moving things"
)


@dataclass(frozen=True)
class Reconstructed:
    """Result of structure from motion.

    Attributes:
        mapper: Mapping that gave the model.
        registered: Names of the photos that were placed.
        missing: Names of those that were not.
        points: Number of points.
        error: Mean reprojection error, pixels.
        observations: Mean number of photos that see a point.
        cameras: A text for each camera.
    """

    mapper: str
    registered: tuple[str, ...]
    missing: tuple[str, ...]
    points: int
    error: float
    observations: float
    cameras: tuple[str, ...]


def load_pycolmap() -> Any:
    """Import pycolmap, its log limited to fatal errors.

    Raises:
        MissingExtraError: It is not installed.
    """
    try:
        # The library's import takes Ctrl-C for a broken installation. Its handler of SIGTERM prints
        # its stack, or waits for ever within `malloc`.
        with held_signals(masked=True):
            library = importlib.import_module("pycolmap")
    except ImportError as error:
        raise MissingExtraError("pycolmap", "sfm") from error
    if not hasattr(library, "global_mapping"):
        raise MissingExtraError("pycolmap 4 or later", "sfm")
    library.logging.minloglevel = library.logging.FATAL.value
    library.logging.alsologtostderr = False
    return library


def find_features(
    gathered: PhotoSet, photos: Path, database: Path, lens: LensModel, tick: Tick, features: int
) -> None:
    """SIFT keypoints of every photo that has none yet; photos of one lens and size share a camera.

    Args:
        gathered: The photos.
        photos: Folder of the upright photos.
        database: Created if missing.
        lens: Camera model.
        tick: Called with progress.
        features: Most keypoints of a photo.
    """
    colmap = load_pycolmap()
    _remove_begun_camera(colmap, database)
    done, total = 0, len(gathered.photos)
    for group, cut in _groups(gathered.photos):
        reader = colmap.ImageReaderOptions()
        reader.camera_model = lens if len(group) >= FEW else "SIMPLE_RADIAL"
        if cut is not None:
            reader.camera_model = "PINHOLE"
            reader.camera_params = ",".join(map(str, cut.pinhole[2:]))
        for start in range(0, len(group), CHUNK):
            names = group[start : start + CHUNK]
            there, camera = _known(colmap, database, group)
            if camera is not None:
                reader.existing_camera_id = camera
            left = [name for name in names if name not in there]
            if left:
                mode = colmap.CameraMode.SINGLE
                extract_keypoints(photos, database, left, features, mode, reader)
            done += len(names)
            tick(done, total)
    _set_rig(colmap, gathered.photos, database)


def extract_keypoints(
    photos: Path, database: Path, names: Sequence[str], features: int, mode: Any, reader: Any
) -> None:
    """SIFT keypoints of photos, at most so many each; a `CameraMode` says who shares a camera."""
    colmap = load_pycolmap()
    options = colmap.FeatureExtractionOptions()
    options.num_threads, options.sift.max_num_features = threads(), features
    colmap.extract_features(
        database,
        photos,
        image_names=names,
        camera_mode=mode,
        reader_options=reader,
        extraction_options=options,
    )


def _remove_begun_camera(colmap: Any, database: Path) -> None:
    """Remove a database with a camera that no photo has: a kill came between them.

    The next photo would get another camera, of another number.
    """
    if not database.exists():
        return
    with colmap.Database.open(database) as opened:
        used = {image.camera_id for image in opened.read_all_images()}
        begun = any(camera.camera_id not in used for camera in opened.read_all_cameras())
    if begun:
        for path in database.parent.glob(f"{database.name}*"):
            path.unlink()


def _set_rig(colmap: Any, photos: Sequence[Photo], database: Path) -> None:
    """Tell the database that views of a panorama stand in one place, and how they are turned."""
    cuts = {photo.lens: photo.cut for photo in photos if photo.cut is not None}
    if not cuts:
        return
    views = [cuts[lens] for lens in sorted(cuts)]
    cameras, first = list[Any](), views[0].rotation
    for number, cut in enumerate(views):
        turn = colmap.Rotation3d(cut.rotation @ first.T)
        placed = colmap.Rigid3d(turn, np.zeros(3)) if number else None
        camera = colmap.RigConfigCamera(
            ref_sensor=not number, image_prefix=view_folder(number), cam_from_rig=placed
        )
        cameras.append(camera)
    with colmap.Database.open(database) as opened:
        colmap.apply_rig_config([colmap.RigConfig(cameras=cameras)], opened)


def match_features(gathered: PhotoSet, database: Path, matching: Matching, tick: Tick) -> None:
    """Compare pairs of photos and keep the matches that one geometry explains.

    Args:
        gathered: The photos.
        database: With keypoints.
        matching: Not `auto`.
        tick: Called with progress.
    """
    names = [photo.name for photo in gathered.photos]
    pairs = _pairs(gathered.photos, matching)
    match_pairs(database, names, pairs, tick)
    if matching != "exhaustive":
        more = transitive_pairs(_verified(database, names), pairs)
        match_pairs(database, names, more, tick)


def sources_of(photos: Sequence[Photo]) -> list[str]:
    """Names of the photos, those that were cut under the name of their panorama once, sorted."""
    return sorted({_source_of(photo) for photo in photos})


def _source_of(photo: Photo) -> str:
    return photo.name if photo.cut is None else photo.name.partition("/")[2]


def _pairs(photos: Sequence[Photo], matching: Matching) -> list[Pair]:
    """Pairs to compare first: of panoramas every view with every one of another, but the poles'.

    Views up and down are compared with their like alone, and none with those of its own panorama.
    """
    sources = sources_of(photos)
    if len(sources) == len(photos):
        return first_pairs(len(photos), matching)
    found, own = list[Pair](), dict[str, list[int]]()
    for index, photo in enumerate(photos):
        own.setdefault(_source_of(photo), []).append(index)
    for first, second in first_pairs(len(sources), matching):
        for a in own[sources[first]]:
            for b in own[sources[second]]:
                looks = [photo.cut.rotation[2, 1] for p in (a, b) if (photo := photos[p]).cut]
                if len(looks) < 2 or (abs(looks[0] - looks[1]) < 0.5):
                    found.append((min(a, b), max(a, b)))
    return found


def map_photos(
    gathered: PhotoSet, photos: Path, database: Path, folder: Path, mapper: Mapper
) -> str:
    """Poses and points into `folder`, whole or not at all; the name of the mapping that gave them.

    Raises:
        SceneError: Fewer than three photos could be placed; says what to try.
    """
    colmap = load_pycolmap()
    found: list[tuple[int, str, Any]] = []
    for name, run in (("global", _map_globally), ("incremental", _map_in_steps)):
        if mapper not in {"auto", name}:
            continue
        scratch = folder.with_name(f".{name}")
        model = _largest(run(colmap, database, photos, scratch, _refined(gathered.photos)))
        if model is not None:
            found.append((model.num_reg_images(), name, model))
        if found and found[-1][0] >= GOOD_SHARE * len(gathered.photos):
            break
    placed, name, model = max(found, key=lambda item: item[0], default=(0, "", None))
    if model is None or placed < FEWEST:
        raise SceneError(
            gathered.folder,
            found=f"{placed} of {len(gathered.photos)} photos that fit together",
            expected=f"at least {FEWEST}",
            advice=OVERLAP,
        )
    draft = folder.with_name(f".{folder.name}")
    shutil.rmtree(draft, ignore_errors=True)
    draft.mkdir(parents=True)
    model.write_binary(draft)
    os.replace(draft, folder)
    return name


def _refined(photos: Sequence[Photo]) -> bool:
    """False if all photos are cut out of panoramas: their focal lengths are known."""
    return not all(photo.cut for photo in photos)


def set_upright(folder: Path, up: Sequence[float] | None = None) -> None:
    """Turns and moves the model in a folder: its middle is the origin, up is z."""
    colmap = load_pycolmap()
    model = colmap.Reconstruction(folder)
    points = np.array([point.xyz for point in model.points3D.values()])
    given = None if up is None else np.asarray(up, np.float64)
    motion = upright(_cameras(model), points, given)
    model.transform(colmap.Sim3d(motion))
    model.write_binary(folder)


def undistort(photos: Path, folder: Path, out: Path) -> None:
    """Photos and model without lens distortion: `out/images` and `out/sparse/0`.

    Args:
        photos: Folder of the photos.
        folder: The model.
        out: Where both are put, whole or not at all.
    """
    colmap = load_pycolmap()
    draft = folder.with_name("undistorted")
    shutil.rmtree(draft, ignore_errors=True)
    colmap.undistort_images(draft, folder, photos, jpeg_quality=JPEG_QUALITY, num_threads=threads())
    model = draft / "model"
    model.mkdir()
    for name in ("cameras", "images", "points3D"):
        os.replace(draft / "sparse" / f"{name}.bin", model / f"{name}.bin")
    shutil.rmtree(out / "images", ignore_errors=True)
    shutil.rmtree(out / "sparse", ignore_errors=True)
    os.replace(draft / "images", out / "images")
    (out / "sparse").mkdir()
    os.replace(model, out / "sparse" / "0")
    shutil.rmtree(draft)


def warps_of(folder: Path, straight: Path) -> dict[str, Warp]:
    """Warp that `undistort` applied to each placed photo, by name.

    Args:
        folder: The model with distortion.
        straight: The model without.
    """
    colmap, found = load_pycolmap(), dict[str, Warp]()
    before, after = colmap.Reconstruction(folder), colmap.Reconstruction(straight)
    pinholes = {image.name: after.cameras[image.camera_id] for image in after.images.values()}
    for image in before.images.values():
        camera, pinhole = before.cameras[image.camera_id], pinholes.get(image.name)
        if pinhole is not None:
            (fx, fy, cx, cy), lens = lens_of(camera.model_name, camera.params)
            photo = (int(camera.width), int(camera.height), fx, fy, cx, cy)
            (fx, fy, cx, cy), _ = lens_of(pinhole.model_name, pinhole.params)
            view = (int(pinhole.width), int(pinhole.height), fx, fy, cx, cy)
            found[image.name] = Warp(lens, photo, view)
    return found


def summary_of(folder: Path, names: Sequence[str], mapper: str) -> Reconstructed:
    """Facts about the model in a folder, which was to place the photos with these names."""
    model = load_pycolmap().Reconstruction(folder)
    registered = sorted(image.name for image in model.images.values() if image.has_pose)
    return Reconstructed(
        mapper=mapper,
        registered=tuple(registered),
        missing=tuple(sorted(set(names) - set(registered))),
        points=int(model.num_points3D()),
        error=float(model.compute_mean_reprojection_error()),
        observations=float(model.compute_mean_track_length()),
        cameras=tuple(_camera_text(camera) for _, camera in sorted(model.cameras.items())),
    )


def _camera_text(camera: Any) -> str:
    focal = f"{camera.mean_focal_length():.1f}"
    return f"{camera.model_name} {camera.width} × {camera.height}, focal length {focal} px"


def threads() -> int:
    """Cores that this process may use; -1: all."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else -1


def _groups(photos: Sequence[Photo]) -> list[tuple[list[str], Cut | None]]:
    """Names of the photos of each camera: one size, one lens; and how they are cut."""
    groups: dict[tuple[tuple[int, int], str], list[Photo]] = {}
    for photo in photos:
        groups.setdefault((photo.size, photo.lens), []).append(photo)
    return [([photo.name for photo in group], group[0].cut) for group in groups.values()]


def _known(colmap: Any, database: Path, names: Sequence[str]) -> tuple[set[str], int | None]:
    """Photos of these that have keypoints already, and the camera that they share."""
    if not database.exists():
        return set(), None
    with colmap.Database.open(database) as open_database:
        images = {image.name: image for image in open_database.read_all_images()}
        ours = [images[name] for name in names if name in images]
        there = {i.name for i in ours if open_database.exists_descriptors(i.image_id)}
    return there, ours[0].camera_id if ours else None


def match_pairs(database: Path, names: Sequence[str], pairs: Sequence[Pair], tick: Tick) -> None:
    """Compare pairs of photos, places in `names`, and keep what one geometry explains.

    Args:
        database: With keypoints.
        names: Of the photos.
        pairs: Which.
        tick: Called with progress.
    """
    colmap = load_pycolmap()
    options, pairing = colmap.FeatureMatchingOptions(), colmap.ImportedPairingOptions()
    options.num_threads = threads()
    geometry = colmap.TwoViewGeometryOptions()
    geometry.ransac.random_seed = SEED
    with colmap.Database.open(database) as opened:
        rigs = opened.num_rigs() < opened.num_cameras()
    options.rig_verification = options.skip_image_pairs_in_same_frame = rigs
    listing = database.with_name("pairs.txt")
    pairing.match_list_path = listing
    for start in range(0, len(pairs), PAIR_CHUNK):
        chunk = pairs[start : start + PAIR_CHUNK]
        listing.write_text("".join(f"{names[a]} {names[b]}\n" for a, b in chunk), "utf-8")
        colmap.match_image_pairs(
            database,
            matching_options=options,
            pairing_options=pairing,
            verification_options=geometry,
        )
        tick(min(start + PAIR_CHUNK, len(pairs)), len(pairs))
    listing.unlink(missing_ok=True)


def _verified(database: Path, names: Sequence[str]) -> Iterator[tuple[Pair, int]]:
    """Pairs that one geometry explains, and how many points they share."""
    colmap, place = load_pycolmap(), {name: index for index, name in enumerate(names)}
    with colmap.Database.open(database) as open_database:
        indices = {i.image_id: place.get(i.name) for i in open_database.read_all_images()}
        numbers, inliers = open_database.read_two_view_geometry_num_inliers()
    for number, points in zip(numbers, inliers, strict=True):
        first, second = colmap.pair_id_to_image_pair(number)
        a, b = indices.get(first), indices.get(second)
        if a is not None and b is not None and points:
            yield (min(a, b), max(a, b)), int(points)


def _map_globally(colmap: Any, database: Path, photos: Path, scratch: Path, refined: bool) -> Any:
    options, calibration = colmap.GlobalPipelineOptions(), colmap.ViewGraphCalibrationOptions()
    options.num_threads, options.random_seed = threads(), SEED
    # The pipeline's seed does not reach its parts.
    mapper = options.mapper
    for part in (mapper, mapper.rotation_averaging, mapper.global_positioning, calibration):
        part.random_seed = SEED
    # Rigs are of panoramas, whose views are turned by what they were cut with.
    bundle = mapper.bundle_adjustment
    for part in (mapper, mapper.rotation_averaging, mapper.global_positioning, bundle):
        part.refine_sensor_from_rig = False
    bundle.refine_focal_length = bundle.refine_extra_params = refined

    def run(out: Path) -> Any:
        # Focal lengths are guesses where EXIF has none; calibration changes the database. The copy
        # is in a new folder, as SQLite reads what a kill left beside a file of the same name.
        copy = out / database.name
        shutil.copyfile(database, copy)
        if refined:
            colmap.calibrate_view_graph(copy, calibration)
        return colmap.global_mapping(copy, photos, out, options)

    return _mapped(run, scratch)


def _map_in_steps(colmap: Any, database: Path, photos: Path, scratch: Path, refined: bool) -> Any:
    options = colmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed, options.min_model_size = threads(), SEED, FEWEST
    options.ba_refine_sensor_from_rig = False
    options.ba_refine_focal_length = options.ba_refine_extra_params = refined
    return _mapped(lambda out: colmap.incremental_mapping(database, photos, out, options), scratch)


def _mapped(run: Callable[[Path], Any], scratch: Path) -> Any:
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir(parents=True)
    try:
        return run(scratch)
    except (RuntimeError, ValueError):  # nothing that could be mapped
        return {}
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _largest(models: Any) -> Any:
    return max(models.values(), key=lambda model: model.num_reg_images(), default=None)


def _cameras(model: Any) -> list[Camera]:
    """Poses of all placed photos, as cameras of one pixel."""
    cameras: list[Camera] = []
    for image in model.images.values():
        if image.has_pose:
            w2c = np.eye(4)
            w2c[:3] = image.cam_from_world().matrix()
            cameras.append(Camera(1, 1, 1.0, 1.0, 0.5, 0.5, w2c))
    return cameras
