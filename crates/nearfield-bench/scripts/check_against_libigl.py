#!/usr/bin/env python3
"""Compares the distance fields of meshes by the `nearfield` command with libigl.

Needs numpy and libigl (pip install libigl). Every node of the grid must have libigl's distance within 1e-6 of the diagonal of the
mesh (command and libigl start from the same file; the command keeps vertices in f32 about an origin). On closed meshes the sign
must be that of libigl's pseudonormals; on any mesh the sign by winding number that of libigl's exact winding number at some nodes.
Nodes nearer to the surface than 1e-6 of the diagonal, or whose winding number is within 1e-3 of one half, may have either sign.
Ends with 1 where something differs.

    check_against_libigl.py target/release/nearfield spot.obj fandisk.obj stanford-bunny.obj --resolution 65
    check_against_libigl.py --self-test
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import igl
import numpy as np

from nearfield_command import run

# Of the diagonal.
DISTANCE = 1e-6
# Winding numbers so near to one half have no side: the command sums in f64 by a tree, libigl exactly.
UNDECIDED = 1e-3


def nodes_of(field):
    """Places of the nodes [n, 3] in f64, x fastest, as the values stand."""
    shape = field["values"].shape
    k, j, i = np.meshgrid(*(np.arange(n, dtype=np.float64) for n in shape), indexing="ij")
    index = np.stack([i, j, k], axis=-1).reshape(-1, 3)
    return np.asarray(field["origin"], np.float64) + np.asarray(field["spacing"], np.float64) * index


def is_closed(triangles):
    """Whether every edge has two triangles that run along it in opposite directions."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    there = {tuple(edge) for edge in edges.tolist()}
    return len(there) == len(edges) and all((b, a) in there for a, b in there)


def compare_distances(values, truth, diagonal):
    """Sentences about distances that differ, and the largest difference in diagonals."""
    off = np.abs(np.abs(values) - truth) / diagonal
    if not np.all(np.isfinite(off)):
        return [f"{np.count_nonzero(~np.isfinite(off))} nodes have no value"], float("nan")
    wrong = np.count_nonzero(off > DISTANCE)
    return ([f"{wrong} distances differ by more than {DISTANCE} of the diagonal"] if wrong else []), float(off.max())


def compare_signs(values, inside, decided):
    """Sentences about signs that differ."""
    wrong = np.count_nonzero(((values < 0) != inside) & decided)
    return [f"{wrong} of {np.count_nonzero(decided)} signs differ"] if wrong else []


def self_test():
    """Differences planted in a right answer must be found."""
    truth = np.linspace(0.0, 1.0, 101)
    values = np.where(np.arange(101) % 2 == 0, -truth, truth).astype(np.float32)
    inside, decided = values < 0, truth > DISTANCE
    right = compare_distances(values, truth, 1.0)[0] + compare_signs(values, inside, decided)
    moved, turned, lost = values.copy(), values.copy(), values.copy()
    moved[50] += 1e-5
    turned[50] = -turned[50]
    lost[50] = np.nan
    planted = {
        "distance": compare_distances(moved, truth, 1.0)[0],
        "lost": compare_distances(lost, truth, 1.0)[0],
        "sign": compare_signs(turned, inside, decided),
    }
    unfound = [name for name, found in planted.items() if not found]
    square = np.array([[0, 1, 2], [0, 2, 3]])
    tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    if right or unfound or is_closed(square) or not is_closed(tetrahedron):
        sys.exit(f"self-test failed: right answer {right}, not found {unfound}")
    print(f"self-test: {len(planted)} planted differences found, the right answer passes")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", nargs="?", help="the nearfield binary")
    parser.add_argument("meshes", nargs="*", type=Path)
    parser.add_argument("--resolution", type=int, default=65)
    parser.add_argument("--winding-nodes", type=int, default=1500, help="nodes whose exact winding number is computed")
    parser.add_argument("--self-test", action="store_true", help="only test the comparison")
    options = parser.parse_args()
    self_test()
    if options.self_test:
        return
    if options.command is None or not options.meshes:
        parser.error("needs a command and meshes")
    failed = False
    for path in options.meshes:
        vertices, triangles = igl.read_triangle_mesh(str(path))
        vertices, triangles = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(triangles, np.int64)
        diagonal = float(np.linalg.norm(vertices.max(0) - vertices.min(0)))
        closed = is_closed(triangles)
        with tempfile.TemporaryDirectory() as folder:
            for sign in (["pseudonormal"] if closed else []) + ["winding-number"]:
                out = Path(folder) / "field.npz"
                told = json.loads(run(options.command, "sdf", path, "--resolution", options.resolution, "--band", "inf",
                                      "--sign", sign, "-o", out, "--force", "--json"))
                field = np.load(out)
                values, places = field["values"].reshape(-1).astype(np.float64), nodes_of(field)
                start = time.time()
                squared, _, _ = igl.point_mesh_squared_distance(places, vertices, triangles)
                truth = np.sqrt(squared)
                errors, off = compare_distances(values, truth, diagonal)
                if sign == "pseudonormal":
                    kind = igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
                    signed = igl.signed_distance(places, vertices, triangles, sign_type=kind)[0]
                    decided = truth > DISTANCE * diagonal
                    errors += compare_signs(values, signed < 0, decided)
                else:
                    rng = np.random.default_rng(1)
                    # Half of them near the surface, where it is difficult.
                    near = np.argsort(truth)[: len(truth) // 10]
                    half = options.winding_nodes // 2
                    chosen = np.concatenate([rng.choice(near, min(half, len(near)), replace=False),
                                             rng.choice(len(truth), min(half, len(truth)), replace=False)])
                    winding = np.asarray(igl.winding_number(vertices, triangles, np.ascontiguousarray(places[chosen])))
                    decided = (truth[chosen] > DISTANCE * diagonal) & (np.abs(winding - 0.5) > UNDECIDED)
                    errors += compare_signs(values[chosen], winding > 0.5, decided)
                failed = failed or bool(errors)
                print(f"{path.name}: {len(triangles)} triangles, {'closed' if closed else 'open'}, {len(values)} nodes, sign by {sign}: "
                      f"largest difference {off:.2e} of the diagonal, {np.count_nonzero(decided)} signs compared, "
                      f"ours {sum(told['milliseconds'].values()) if isinstance(told.get('milliseconds'), dict) else 0:.0f} ms, "
                      f"libigl {time.time() - start:.1f} s: " + ("FAILED" if errors else "equal"))
                for error in errors:
                    print(f"  {error}")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
