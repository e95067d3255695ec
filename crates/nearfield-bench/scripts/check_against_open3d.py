#!/usr/bin/env python3
"""Compares normals, signed distances and smoothing by the `nearfield` command with Open3D.

Needs numpy and open3d (pip install open3d; 0.20 or later for its smoothing). For each mesh:

- normals of the planes of the k nearest of its noisy samples: but for the side the same, within 0.1 degrees for 99.9 % of them (where
  the k-th nearest is a tie, or neighbours spread alike in two directions, either answer is right);
- on closed meshes signed distances at the nodes of a grid: within 1e-5 of the diagonal, as Open3D computes in f32, and the same sign
  farther than that from the surface, but for one node in a thousand: Open3D counts crossings of rays, which edges mislead.

Then a noisy torus is smoothed by one step of both with weights as wide: Open3D's is a Gaussian cut at one width, where it is 0.37; ours,
(1 - d²/h²)⁴, nearly has that width for h twice as long and ends there smoothly. Heights of degree 2 must end nearer to the truth than
Open3D's planes. Ends with 1 where something differs.

    check_against_open3d.py target/release/nearfield spot.obj fandisk.obj --resolution 65
    check_against_open3d.py --self-test
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import open3d as o3d

from nearfield_command import run

# Degrees, and the share of normals that may differ by more.
ANGLE, MOST_APART = 0.1, 1e-3
# Of the diagonal, and the share of signs that may differ.
DISTANCE, MOST_TURNED = 1e-5, 1e-3
SAMPLES, NEAREST = 100_000, 24
# Torus of radii 1 and 0.4 with 0.5 % noise; about 98 neighbours within Open3D's radius.
TORUS_SAMPLES, TORUS_RADIUS = 100_000, 0.075


def world(cloud):
    """Positions of a cloud's NPZ in f64."""
    points = cloud["points"].astype(np.float64)
    return points + np.asarray(cloud["origin"], np.float64) if "origin" in cloud else points


def compare_normals(ours, theirs):
    """Sentences about normals that differ, and the angles in degrees at the median, at 99.9 % and at most."""
    # By the sine: the arc cosine loses small angles.
    angles = np.degrees(np.arcsin(np.clip(np.linalg.norm(np.cross(ours, theirs), axis=1), 0.0, 1.0)))
    apart = np.count_nonzero(~(angles <= ANGLE))
    errors = [f"{apart} of {len(ours)} normals differ by more than {ANGLE} degrees"] if apart > MOST_APART * len(ours) else []
    return errors, np.quantile(angles, [0.5, 0.999, 1.0])


def compare_distances(ours, theirs, diagonal):
    """Sentences about signed distances that differ, the largest difference without signs in diagonals, and how many signs differ."""
    off = np.abs(np.abs(ours) - np.abs(theirs)) / diagonal
    turned = np.count_nonzero(((ours < 0) != (theirs < 0)) & (np.abs(theirs) > DISTANCE * diagonal))
    errors = []
    if not np.all(off <= DISTANCE):
        errors.append(f"{np.count_nonzero(~(off <= DISTANCE))} distances differ by more than {DISTANCE} of the diagonal")
    if turned > MOST_TURNED * len(ours):
        errors.append(f"{turned} of {len(ours)} signs differ")
    return errors, float(np.nanmax(off)), turned


def off_torus(points):
    """Root mean square of the distances from the torus in percent of its diagonal."""
    distance = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 1.0, points[:, 2]) - 0.4
    return 100.0 * float(np.sqrt(np.mean(distance**2))) / np.sqrt(2 * 2.8**2 + 0.8**2)


def self_test():
    """Differences planted in a right answer must be found."""
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(3000, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    distances = np.linspace(-1.0, 1.0, 3000)
    bent = normals.copy()
    bent[:10] += 0.01
    bent /= np.linalg.norm(bent, axis=1)[:, None]
    right = compare_normals(-normals, normals)[0] + compare_distances(distances, distances, 1.0)[0]
    planted = {
        "normal": compare_normals(bent, normals)[0],
        "lost normal": compare_normals(np.where(np.arange(3000)[:, None] < 10, np.nan, normals), normals)[0],
        "distance": compare_distances(distances + 1e-4 * (np.arange(3000) == 5), distances, 1.0)[0],
        "sign": compare_distances(np.where(np.arange(3000) < 10, -distances, distances), distances, 1.0)[0],
    }
    unfound = [name for name, found in planted.items() if not found]
    if right or unfound or not 0 < off_torus(np.array([[1.5, 0.0, 0.0]])) < 3:
        sys.exit(f"self-test failed: right answer {right}, not found {unfound}")
    print(f"self-test: {len(planted)} planted differences found, the right answer passes")


def check_normals(command, path, folder, device):
    scan, out = folder / "scan.npz", folder / "normals.npz"
    run(command, "sample", path, "-n", SAMPLES, "--noise", "0.2%", "--seed", 1, "-o", scan, "--force", "-q")
    start = time.time()
    run(command, "normals", scan, "--k", NEAREST, "--orient", "none", "--device", device, "-o", out, "--force", "-q")
    seconds = time.time() - start
    cloud = np.load(out)
    start = time.time()
    theirs = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(world(cloud)))
    theirs.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(NEAREST))
    errors, (median, most, largest) = compare_normals(cloud["normals"].astype(np.float64), np.asarray(theirs.normals))
    print(f"{path.name}: normals of {SAMPLES} noisy samples by {NEAREST} nearest: angle {median:.1e} degrees at the median, {most:.1e} at "
          f"99.9 %, {largest:.1e} at most; ours {seconds:.1f} s with its files, Open3D {time.time() - start:.1f} s: "
          + ("FAILED" if errors else "equal"))
    return errors


def check_distances(command, path, folder, resolution):
    mesh = o3d.io.read_triangle_mesh(str(path))
    # Corners that are stored more than once, for textures, are one.
    mesh.merge_close_vertices(1e-9)
    if not mesh.is_edge_manifold(allow_boundary_edges=False):
        print(f"{path.name}: open, so signs by counting crossings mean nothing; distances are not compared")
        return []
    diagonal = float(np.linalg.norm(mesh.get_max_bound() - mesh.get_min_bound()))
    out = folder / "field.npz"
    run(command, "sdf", path, "--resolution", resolution, "--band", "inf", "-o", out, "--force", "-q")
    field = np.load(out)
    k, j, i = np.meshgrid(*(np.arange(n, dtype=np.float64) for n in field["values"].shape), indexing="ij")
    places = np.asarray(field["origin"]) + np.asarray(field["spacing"]) * np.stack([i, j, k], axis=-1).reshape(-1, 3)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    theirs = scene.compute_signed_distance(o3d.core.Tensor(places.astype(np.float32)), nsamples=5).numpy()
    errors, off, turned = compare_distances(field["values"].reshape(-1).astype(np.float64), theirs.astype(np.float64), diagonal)
    print(f"{path.name}: signed distances of {len(places)} nodes: largest difference {off:.1e} of the diagonal, {turned} signs differ: "
          + ("FAILED" if errors else "equal"))
    return errors


def check_smoothing(command, folder, device):
    noisy = folder / "noisy.npz"
    run(command, "generate", "torus", "-n", TORUS_SAMPLES, "--noise", "0.5%", "--seed", 1, "-o", noisy, "--force", "-q")
    points = world(np.load(noisy))
    rows = {"before": off_torus(points)}
    for degree, radius in ((0, TORUS_RADIUS), (0, 2 * TORUS_RADIUS), (2, TORUS_RADIUS), (2, 2 * TORUS_RADIUS)):
        out = folder / "smooth.npz"
        run(command, "smooth", noisy, "--method", "pss", "--degree", degree, "--radius", radius, "--mode", "smooth", "--iterations", 1,
            "--device", device, "-o", out, "--force", "-q")
        rows[f"ours, degree {degree}, h = {radius}"] = off_torus(world(np.load(out)))
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(points.astype(np.float32)))
    rows[f"Open3D, {TORUS_RADIUS}"] = off_torus(cloud.smooth_mls(TORUS_RADIUS, 1000).point.positions.numpy().astype(np.float64))
    rows["Open3D, its defaults"] = off_torus(cloud.smooth_mls().point.positions.numpy().astype(np.float64))
    ours, theirs = rows[f"ours, degree 2, h = {2 * TORUS_RADIUS}"], rows[f"Open3D, {TORUS_RADIUS}"]
    errors = [] if ours < theirs < rows["before"] else ["heights of degree 2 are not nearer to the truth than Open3D's planes"]
    print("torus, one step, RMS in % of the diagonal: " + ", ".join(f"{name} {value:.4f}" for name, value in rows.items())
          + (": FAILED" if errors else ": as it should be"))
    return errors


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", nargs="?", help="the nearfield binary")
    parser.add_argument("meshes", nargs="*", type=Path)
    parser.add_argument("--resolution", type=int, default=65)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--self-test", action="store_true", help="only test the comparison")
    options = parser.parse_args()
    self_test()
    if options.self_test:
        return
    if options.command is None or not options.meshes:
        parser.error("needs a command and meshes")
    errors = []
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        for path in options.meshes:
            errors += check_normals(options.command, path, folder, options.device)
            errors += check_distances(options.command, path, folder, options.resolution)
        errors += check_smoothing(options.command, folder, options.device)
    for error in errors:
        print(f"  {error}")
    sys.exit(1 if errors else 0)


if __name__ == "__main__":
    main()
