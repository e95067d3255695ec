#!/usr/bin/env python3
"""Compares the lists of the `nearfield` command with scipy's cKDTree in f64.

Needs numpy and scipy. The boundary rule: a list may differ from the truth only in points whose distance is within
4 ulp (of f32) of the radius. Everything else is an error: a missing point, an extra one, one that stands twice, a row
out of order, a wrong distance. Ends with 1 if there is one.

    check_against_scipy.py target/release/nearfield scan.pcd --radius 2
    check_against_scipy.py target/release/nearfield scan.laz --radius 5 --device cpu --device gpu \
        --structure brute-force --structure uniform-grid --queries 1000
    check_against_scipy.py --self-test
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from nearfield_command import run

# Distances from the radius within which f32 may decide either way, in ulp of the radius.
BOUNDARY_ULP = 4
# Queries whose true rows are in memory at a time.
QUERIES_AT_ONCE = 20_000


def ulp(x):
    return np.spacing(np.abs(np.asarray(x, np.float32))).astype(np.float64)


def true_pairs(tree, queries, first, reach):
    """Pairs (query, point) within `reach` as sorted keys, and their distances."""
    found = cKDTree(queries).sparse_distance_matrix(tree, reach, output_type="ndarray")
    keys = (found["i"].astype(np.uint64) + np.uint64(first)) * np.uint64(tree.n) + found["j"].astype(np.uint64)
    order = np.argsort(keys, kind="stable")
    return keys[order], found["v"][order]


def compare(points, queries, radius, offsets, indices, distances, sort="index"):
    """Returns a dict of counts; `errors` is a list of sentences."""
    n, q = len(points), len(queries)
    counts = {"entries": int(len(indices)), "true_entries": 0, "at_boundary": 0, "differ_at_boundary": 0, "errors": []}
    errors = counts["errors"]
    if len(offsets) != q + 1 or offsets[0] != 0 or offsets[-1] != len(indices) or np.any(np.diff(offsets.astype(np.int64)) < 0):
        errors.append("offsets are not monotone from 0 to the number of indices, one more than queries")
        return counts
    if len(indices) and indices.max() >= n:
        errors.append(f"index {indices.max()} of {n} points")
        return counts
    if distances is not None and len(distances) != len(indices):
        errors.append(f"{len(distances)} distances for {len(indices)} indices")
        return counts
    tree = cKDTree(points)
    radius64 = float(np.float32(radius))
    slack = BOUNDARY_ULP * float(ulp(radius))
    for first in range(0, q, QUERIES_AT_ONCE):
        last = min(first + QUERIES_AT_ONCE, q)
        keys, true_distances = true_pairs(tree, queries[first:last], first, radius64 + slack)
        span = slice(int(offsets[first]), int(offsets[last]))
        rows = np.repeat(np.arange(first, last, dtype=np.uint64), np.diff(offsets[first : last + 1]).astype(np.int64))
        ours = rows * np.uint64(n) + indices[span].astype(np.uint64)
        if sort == "index" and np.any(ours[1:] <= ours[:-1]):
            errors.append(f"queries {first} to {last}: a row is not ascending by index, or holds a point twice")
        order = np.argsort(ours, kind="stable")
        ours = ours[order]
        if np.any(ours[1:] == ours[:-1]):
            errors.append(f"queries {first} to {last}: a point stands twice in a row")
        sure = true_distances < radius64 - slack
        counts["true_entries"] += int(np.count_nonzero(true_distances <= radius64))
        counts["at_boundary"] += int(np.count_nonzero(~sure))
        missing = np.setdiff1d(keys[sure], ours)
        extra = np.setdiff1d(ours, keys)
        for name, which in (("missing", missing), ("extra", extra)):
            if len(which):
                query, point = int(which[0] // n), int(which[0] % n)
                distance = np.linalg.norm(points[point] - queries[query])
                errors.append(f"{len(which)} {name}, first: query {query}, point {point} at {distance!r}")
        inside = keys[true_distances <= radius64]
        counts["differ_at_boundary"] += len(np.setxor1d(inside, ours)) - len(missing) - len(extra)
        if distances is not None:
            place = np.minimum(np.searchsorted(keys, ours), len(keys) - 1)
            known = keys[place] == ours if len(keys) else np.zeros(len(ours), bool)
            off = np.abs(distances[span][order].astype(np.float64)[known] - true_distances[place[known]])
            wrong = off > BOUNDARY_ULP * ulp(true_distances[place[known]])
            if np.any(wrong):
                errors.append(f"{np.count_nonzero(wrong)} distances are off by more than {BOUNDARY_ULP} ulp")
    return counts


def self_test():
    """Differences planted in a right answer must be found."""
    rng = np.random.default_rng(1)
    points = rng.random((300, 3)).astype(np.float32).astype(np.float64)
    tree = cKDTree(points)
    rows = [sorted(row) for row in tree.query_ball_point(points, 0.2)]
    offsets = np.cumsum([0] + [len(row) for row in rows]).astype(np.uint64)
    indices = np.concatenate(rows).astype(np.uint32)
    query = np.repeat(np.arange(300), np.diff(offsets.astype(np.int64)))
    distances = np.linalg.norm(points[query] - points[indices], axis=1).astype(np.float32)

    def errors(offsets=offsets, indices=indices, distances=distances):
        return compare(points, points, 0.2, offsets, indices, distances)["errors"]

    def changed(values, at, value):
        values = values.copy()
        values[at] = value
        return values

    shorter = offsets.copy()
    shorter[1:] -= np.uint64(1)
    far = int(np.argmax(np.linalg.norm(points - points[0], axis=1)))
    longest = int(np.argmax(np.diff(offsets.astype(np.int64))))
    start = int(offsets[longest])
    planted = {
        "missing": errors(shorter, indices[1:], distances[1:]),
        "extra": errors(indices=changed(indices, 1, far)),
        "twice": errors(indices=changed(indices, start + 1, indices[start])),
        "order": errors(indices=changed(changed(indices, start, indices[start + 1]), start + 1, indices[start])),
        "distance": errors(distances=changed(distances, 5, distances[5] * 1.001 + 1e-3)),
        "offsets": errors(offsets=changed(offsets, 3, offsets[2] - np.uint64(1))),
        "range": errors(indices=changed(indices, 0, 300)),
    }
    unfound = [name for name, found in planted.items() if not found]
    if errors() or unfound:
        sys.exit(f"self-test failed: right answer {errors()}, not found {unfound}")
    print(f"self-test: {len(planted)} planted differences found, the right answer passes")


def world_points(command, file, folder, name):
    """Positions as the command keeps them, in f64 world coordinates."""
    out = folder / name
    run(command, "convert", file, out, "--points-only", "--force", "--quiet")
    return np.load(out)["points"].astype(np.float64)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", nargs="?", help="the nearfield binary")
    parser.add_argument("file", nargs="?", type=Path)
    parser.add_argument("--radius", type=float)
    parser.add_argument("--device", action="append", help="may be given more than once; default cpu")
    parser.add_argument("--structure", action="append", help="may be given more than once; default uniform-grid")
    parser.add_argument("--queries", type=int, default=0, help="ask around this many points of the file, not all")
    parser.add_argument("--self-test", action="store_true", help="only test the comparison")
    options = parser.parse_args()
    self_test()
    if options.self_test:
        return
    if options.command is None or options.file is None or options.radius is None:
        parser.error("needs a command, a file and --radius")
    failed = False
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        points = world_points(options.command, options.file, folder, "points.npz")
        queries, ask = points, []
        if options.queries:
            rng = np.random.default_rng(2)
            chosen = np.sort(rng.choice(len(points), min(options.queries, len(points)), replace=False))
            np.savetxt(folder / "queries.xyz", points[chosen], fmt="%.17g")
            # What the command makes of the text is what it asks around.
            queries = world_points(options.command, folder / "queries.xyz", folder, "queries.npz")
            ask = ["--queries", folder / "queries.xyz"]
        for device in options.device or ["cpu"]:
            for structure in options.structure or ["uniform-grid"]:
                out = folder / "lists.npz"
                summary = json.loads(run(
                    options.command, "neighbors", options.file, "--radius", options.radius, "--sort", "index", "--device", device,
                    "--structure", structure, "--output", out, "--force", "--json", *ask))
                lists = np.load(out)
                start = time.time()
                found = compare(points, queries, options.radius, lists["offsets"], lists["indices"], lists["distances"])
                seconds = time.time() - start
                errors = found.pop("errors")
                if summary["structure"] != structure or summary["neighbors_total"] != found["entries"]:
                    errors.append(f"the summary says {summary['structure']}, {summary['neighbors_total']} neighbours")
                failed = failed or bool(errors)
                print(f"{options.file.name} r={options.radius}: {summary['structure']} on {summary['device']}, {len(queries)} queries, "
                      + ", ".join(f"{name} {value}" for name, value in found.items())
                      + f", scipy {seconds:.1f} s: " + ("FAILED" if errors else "equal"))
                for error in errors:
                    print(f"  {error}")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
