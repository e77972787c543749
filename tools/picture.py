#!/usr/bin/env python3
"""Draws a scene coloured by neighbor count, as in the README.

    tools/picture.py build/vdb_nns docs/images/neighbor_counts.png

Makes the particles of a breaking wave, writes them as .npy, has `vdb_nns search` write the lists, and takes the counts
from the CSR matrix. Needs NumPy, SciPy and Matplotlib (tools/setup.sh --tests).
"""

import argparse
import os
import subprocess
import tempfile

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse
from PIL import Image

RADIUS_FACTOR = 2.0  # radius / spacing: about 30 neighbors in the bulk


def surface_height(x, y):
    """Height of the water over the floor: a pool with a wave that comes from the left."""
    return 0.22 + 0.33 * np.exp(-(((x - 1.05 - 0.12 * np.sin(5 * y)) / 0.28) ** 2)) + 0.02 * np.sin(9 * x + 4 * y)


def make_wave(count, random):
    """Particles of a tank [0,3] x [0,1.2]: jittered bulk, a thin sheet thrown off the crest, and spray."""
    spacing = (0.35 * 3.0 * 1.2 / count) ** (1 / 3)
    axes = [np.arange(0, edge, spacing) for edge in (3.0, 1.2, 0.8)]
    bulk = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    bulk += random.uniform(-0.2, 0.2, bulk.shape) * spacing
    bulk = bulk[bulk[:, 2] < surface_height(bulk[:, 0], bulk[:, 1])]

    # The sheet: an arc that leaves the crest, one to two particles thick, and breaks into drops towards its end.
    along = np.arange(0, 1, spacing / 1.1)
    across = np.arange(0, 1.2, spacing)
    t, y = (values.ravel() for values in np.meshgrid(along, across, indexing="ij"))
    kept = random.uniform(size=t.size) > t**1.5
    t, y = t[kept], y[kept]
    x = 1.05 + 0.12 * np.sin(5 * y) + 0.75 * t
    z = surface_height(1.05, 0 * y) - 0.02 + 0.28 * t - 0.42 * t**2
    sheet = np.stack([x, y, z], axis=-1) + random.normal(size=(t.size, 3)) * (0.3 + 1.8 * t[:, None]) * spacing

    number = count // 30
    t = random.uniform(0.2, 1, number)
    spray = np.stack(
        [
            1.05 + 0.9 * t + random.normal(scale=0.15, size=number),
            random.uniform(0, 1.2, number),
            0.55 + 0.35 * t - 0.35 * t**2 + np.abs(random.normal(scale=0.16, size=number)) * t,
        ],
        axis=-1,
    )
    return np.concatenate([bulk, sheet, spray]), spacing


def neighbor_counts(program, positions, radius):
    """Counts from the lists that the program writes."""
    with tempfile.TemporaryDirectory() as folder:
        points, lists = os.path.join(folder, "points.npy"), os.path.join(folder, "lists.npz")
        np.save(points, positions)
        subprocess.run([program, "search", points, "-r", repr(radius), "-o", lists, "-q"], check=True)
        return np.diff(scipy.sparse.load_npz(lists).indptr)


def draw(positions, counts, path):
    """Parallel projection from above and in front; far particles first, so that near ones cover them."""
    view = np.array([0.35, -1.0, 0.6])
    view /= np.linalg.norm(view)
    right = np.cross([0, 0, 1.0], view)
    right /= np.linalg.norm(right)
    up = np.cross(view, right)
    depth = positions @ view
    order = np.argsort(depth)
    across, height = (positions @ right)[order], (positions @ up)[order]

    figure, axes = plt.subplots(figsize=(12, 5), dpi=100)
    figure.set_facecolor("#10141c")
    axes.set_facecolor("#10141c")
    shown = axes.scatter(across, height, c=counts[order], s=7, lw=0, cmap="turbo", vmin=0,
                         vmax=np.percentile(counts, 99.5))
    axes.set_aspect("equal")
    axes.axis("off")
    bar = figure.colorbar(shown, ax=axes, shrink=0.7, pad=0.01)
    bar.set_label("neighbors", color="white")
    bar.ax.tick_params(colors="white")
    figure.tight_layout()
    figure.savefig(path, facecolor=figure.get_facecolor())
    # A palette keeps the file small: README pictures stay below 300 KB.
    Image.open(path).convert("RGB").quantize(160, dither=Image.Dither.NONE).save(path, optimize=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("program", help="the vdb_nns program")
    parser.add_argument("output", help="the .png to write")
    parser.add_argument("--count", type=int, default=250000, help="particles, about")
    options = parser.parse_args()

    positions, spacing = make_wave(options.count, np.random.default_rng(1))
    counts = neighbor_counts(os.path.abspath(options.program), positions, RADIUS_FACTOR * spacing)
    draw(positions, counts, options.output)
    print(f"{options.output}: {len(positions)} particles, {counts.sum()} pairs, "
          f"{counts.min()} to {counts.max()} neighbors, {os.path.getsize(options.output)} bytes")


if __name__ == "__main__":
    main()
