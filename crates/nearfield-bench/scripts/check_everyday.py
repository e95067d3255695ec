#!/usr/bin/env python3
"""Compares `nearfield cluster`, `filter` and `downsample` with scikit-learn, Open3D and scipy.

Needs numpy, scipy, scikit-learn and open3d (whose wheel wants libusb-1.0-0, libgl1, libegl1, libgomp1 and libx11-6 of Debian).

- dbscan: scikit-learn's `DBSCAN`: core points and labels equal, number by number. Its border points go to the cluster with the smallest core
  index, as ours do: it walks the clusters in that order and never takes a point from one.
- euclidean: connected components of scipy's pairs within the radius (PCL's definition; PCL itself is not run).
- statistical: index sets of Open3D's `remove_statistical_outlier` with --rule open3d; with --rule pcl those of PCL's definition, written with
  scipy here (PCL itself is not run).
- radius: index sets of Open3D's `remove_radius_outlier`, whose ball is open where ours is closed: the same but for ties.
- duplicates: numpy's `unique`.
- voxel: centroids of Open3D's `voxel_down_sample` with --origin below-corner, within 1e-6 of the diagonal.
- farthest: samples of Open3D's `farthest_point_down_sample` from the first point, in f64 as ours are in f32: the distance to the
  samples before is compared, within 1e-5 of it.

References work in f64 on the f32 coordinates that the command reads. Points whose distances are within rounding of a radius or a limit may
differ, and are counted: at most one in 10,000. Everything else ends with 1.

    check_everyday.py target/release/nearfield scan.ply --eps 0.01 --min-points 10
    check_everyday.py target/release/nearfield scan.ply --eps 0.01 --device cpu --device gpu
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import open3d as o3d
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from sklearn.cluster import DBSCAN

MAY_DIFFER = 1e-4


class Refused(Exception):
    """What a device says it cannot do."""


class Check:
    """Runs the command, and keeps the score."""

    def __init__(self, command, file):
        self.command, self.file, self.failed = command, file, False
        self.folder = tempfile.TemporaryDirectory(prefix="nearfield-everyday-")
        self.out = Path(self.folder.name) / "out.npz"
        self.run("convert", file, self.out, "--points-only", "--force", "--quiet")
        self.points = np.load(self.out)["points"].astype(np.float64)

    def run(self, *arguments):
        done = subprocess.run([self.command, *map(str, arguments)], capture_output=True, text=True)
        if "is not supported" in done.stderr:
            raise Refused(done.stderr.strip().splitlines()[-1])
        if done.returncode != 0:
            sys.exit(f"{self.command} {' '.join(map(str, arguments))} ended with {done.returncode}: {done.stderr.strip()}")
        return done.stdout

    def ours(self, verb, by, *arguments):
        """The output of a task as arrays by name, and its report."""
        told = self.run(verb, by, self.file, *arguments, "-o", self.out, "--force", "--json")
        return dict(np.load(self.out)), json.loads(told)

    def tell(self, task, told, differ, n, words, seconds):
        wrong = differ > MAY_DIFFER * n
        self.failed = self.failed or wrong
        ours = told["milliseconds"]["query"] / 1e3
        print(f"{task:<34} {'FAILED' if wrong else 'equal':<7} {differ} of {n} differ; {words}; "
              f"{told['device']} {ours:.2f} s, reference {seconds:.2f} s")


def same_clusters(ours, theirs):
    """How many labels differ once each of our clusters is named as most of its points are there."""
    differ = int(np.sum((ours < 0) != (theirs < 0)))
    both = (ours >= 0) & (theirs >= 0)
    if not both.any():
        return differ
    pairs, counts = np.unique(np.stack([ours[both], theirs[both]]), axis=1, return_counts=True)
    best = {}
    for (a, b), count in zip(pairs.T, counts):
        if count > best.get(a, (0, 0))[0]:
            best[a] = (count, b)
    named = np.array([best[a][1] for a in ours[both]])
    return differ + int(np.sum(named != theirs[both]))


def self_test():
    a = np.array([0, 0, 1, 1, -1])
    assert same_clusters(a, np.array([1, 1, 0, 0, -1])) == 0
    assert same_clusters(a, np.array([1, 1, 0, 1, -1])) == 1
    assert same_clusters(a, np.array([1, 1, 0, 0, 0])) == 1
    assert same_clusters(a, np.array([0, 0, 0, 0, -1])) == 0, "clusters that were joined are found by their number"


def clusters(check, device, eps, min_points):
    n = len(check.points)
    start = time.time()
    theirs = DBSCAN(eps=float(np.float32(eps)), min_samples=min_points, algorithm="kd_tree").fit(check.points)
    seconds = time.time() - start
    ours, told = check.ours("cluster", "dbscan", "--eps", eps, "--min-points", min_points, "--device", device)
    core = np.zeros(n, bool)
    core[theirs.core_sample_indices_] = True
    n_theirs = theirs.labels_.max() + 1
    differ = same_clusters(ours["label"], theirs.labels_) + abs(int(n_theirs) - told["clusters"])
    cores = int(np.sum(core != (ours["core"] == 1)))
    numbers = int(np.sum(ours["label"] != theirs.labels_))
    words = (f"{told['clusters']} clusters, {told['unlabelled']} points of noise; core points: {cores} differ; "
             f"numbers: {numbers} differ")
    check.tell("dbscan, scikit-learn", told, max(differ, cores, numbers), n, words, seconds)

    start = time.time()
    pairs = cKDTree(check.points).query_pairs(float(np.float32(eps)), output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    n_theirs, labels = connected_components(graph, directed=False)
    seconds = time.time() - start
    ours, told = check.ours("cluster", "euclidean", "--radius", eps, "--device", device)
    differ = same_clusters(ours["label"], labels) + abs(int(n_theirs) - told["clusters"])
    check.tell("euclidean, scipy's components", told, differ, n, f"{told['clusters']} clusters", seconds)


def kept_set(n, indices):
    kept = np.zeros(n, bool)
    kept[np.asarray(indices, int)] = True
    return kept


def statistical(check, device, k=20, ratio=2.0):
    n, cloud = len(check.points), o3d.geometry.PointCloud(o3d.utility.Vector3dVector(check.points))
    start = time.time()
    _, indices = cloud.remove_statistical_outlier(k, ratio)
    seconds = time.time() - start
    ours, told = check.ours("filter", "statistical", "--k", k, "--ratio", ratio, "--rule", "open3d", "--mark", "--device", device)
    differ = int(np.sum(kept_set(n, indices) != (ours["kept"] == 1)))
    check.tell("statistical, Open3D", told, differ, n, f"{n - len(indices)} outliers there, {n - told['kept']} here", seconds)

    start = time.time()
    distances, _ = cKDTree(check.points).query(check.points, k=k + 1)
    means = distances[:, 1:].mean(axis=1)
    kept = means <= means.mean() + ratio * means.std(ddof=1)
    seconds = time.time() - start
    ours, told = check.ours("filter", "statistical", "--k", k, "--ratio", ratio, "--mark", "--device", device)
    differ = int(np.sum(kept != (ours["kept"] == 1)))
    off = float(np.max(np.abs(ours["mean_distance"] - means) / np.maximum(means, 1e-30)))
    check.tell("statistical, PCL's rule by scipy", told, differ, n, f"{int(n - kept.sum())} outliers, means off by {off:.1e}", seconds)


def near(check, device, eps, fewest=6):
    n, cloud = len(check.points), o3d.geometry.PointCloud(o3d.utility.Vector3dVector(check.points))
    start = time.time()
    _, indices = cloud.remove_radius_outlier(fewest, float(np.float32(eps)))
    seconds = time.time() - start
    ours, told = check.ours("filter", "radius", "--radius", eps, "--min-neighbors", fewest, "--mark", "--device", device)
    differ = int(np.sum(kept_set(n, indices) != (ours["kept"] == 1)))
    check.tell("radius, Open3D", told, differ, n, f"{n - len(indices)} outliers there, {n - told['kept']} here", seconds)

    start = time.time()
    _, indices = np.unique(check.points + 0.0, axis=0, return_index=True)
    seconds = time.time() - start
    ours, told = check.ours("filter", "duplicates", "--mark", "--device", device)
    differ = int(np.sum(kept_set(n, indices) != (ours["kept"] == 1)))
    check.tell("duplicates, numpy", told, differ, n, f"{n - len(indices)} duplicates", seconds)


def fewer(check, devices, eps, count):
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(check.points))
    diagonal = float(np.linalg.norm(check.points.max(axis=0) - check.points.min(axis=0)))
    for size in [eps, 4 * eps]:
        start = time.time()
        theirs = np.asarray(cloud.voxel_down_sample(size).points)
        seconds = time.time() - start
        for device in devices:
            try:
                ours, told = check.ours("downsample", "voxel", "--size", size, "--origin", "below-corner", "--device", device)
            except Refused as refused:
                # Software renderers end long loops.
                print(f"voxels of {size:.4g}: {refused}")
                continue
            ours = ours["points"].astype(np.float64)
            far, _ = cKDTree(theirs).query(ours)
            back, _ = cKDTree(ours).query(theirs)
            differ = max(int(np.sum(far > 1e-6 * diagonal)), int(np.sum(back > 1e-6 * diagonal)), abs(len(ours) - len(theirs)))
            words = f"{len(ours)} cells here, {len(theirs)} there, farthest mean {max(far.max(), back.max()):.1e}"
            check.tell(f"voxels of {size:.4g}, Open3D", told, differ, len(theirs), words, seconds)

    start = time.time()
    theirs = np.asarray(cloud.farthest_point_down_sample(count).points)
    seconds = time.time() - start
    for device in devices:
        ours, told = check.ours("downsample", "farthest", "--count", count, "--device", device)
        # Theirs come in the order of the file: compare how far every point is from the samples at most, and which they are.
        ours = ours["points"].astype(np.float64)
        common = int(np.sum(cKDTree(theirs).query(ours)[0] == 0))
        cover = [float(cKDTree(samples).query(check.points)[0].max()) for samples in (ours, theirs)]
        differ = 0 if abs(cover[0] - cover[1]) <= 1e-5 * cover[1] else count
        words = f"{common} samples are the same, every point within {cover[0]:.6g} of ours and {cover[1]:.6g} of theirs"
        check.tell(f"{count} farthest points, Open3D", told, differ, count, words, seconds)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", help="the nearfield binary")
    parser.add_argument("file", type=Path)
    parser.add_argument("--eps", type=float, required=True, help="radius of clusters and of radius outliers, and size of voxels")
    parser.add_argument("--min-points", type=int, default=10)
    parser.add_argument("--count", type=int, default=500, help="farthest points")
    parser.add_argument("--device", action="append", help="may be given more than once; default cpu")
    options = parser.parse_args()
    self_test()
    check = Check(options.command, options.file)
    if len(check.points) == 0:
        sys.exit(f"{options.file} has no points")
    print(f"{options.file.name}: {len(check.points)} points, eps {options.eps}, {options.min_points} points, Open3D {o3d.__version__}")
    devices = options.device or ["cpu"]
    for device in devices:
        clusters(check, device, options.eps, options.min_points)
        near(check, device, options.eps)
        try:
            statistical(check, device)
        except Refused as refused:
            # Software renderers end long loops.
            print(f"statistical: {refused}")
    fewer(check, devices, options.eps, min(options.count, len(check.points)))
    sys.exit(1 if check.failed else 0)


if __name__ == "__main__":
    main()
