#!/usr/bin/env python3
"""Draws the weights of neighbors that measures know, as docs/measures.md shows them.

    tools/kernel_chart.py docs/images/kernels.svg

The same bytes every time. Needs NumPy and Matplotlib.
"""

import os
import sys

sys.dont_write_bytecode = True
sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))

import numpy as np
from charts.style import BLACK, BLUE, GREEN, LEADER, PURPLE, SOFT, VERMILION, Chart, axes, figure, letters

WIDTH, HEIGHT = 720, 300


def kernels(q):
    """Name, W(q) R^3, color and dashes: the formulas of vdb_nns/measure.h."""
    inner, outer = 1 - 6 * q**2 + 6 * q**3, 2 * (1 - q) ** 3
    return [
        ("cubic", 8 / np.pi * np.where(q < 0.5, inner, outer), BLUE, "-"),
        ("wendland2", 21 / (2 * np.pi) * (1 - q) ** 4 * (1 + 4 * q), VERMILION, "--"),
        ("poly6", 315 / (64 * np.pi) * (1 - q**2) ** 3, GREEN, "-."),
        ("tophat", 3 / (4 * np.pi) * np.ones_like(q), PURPLE, ":"),
    ]


def check(q):
    """The integral of each over space is 1."""
    for name, values, _, _ in kernels(q):
        inside = 4 * np.pi * values * q**2
        total = np.sum((inside[1:] + inside[:-1]) / 2 * np.diff(q))
        assert abs(total - 1) < 1e-4, (name, total)


def plot(area, q, curves, places):
    for name, values, color, dashes in curves:
        area.plot(q, values, color=color, ls=dashes, lw=1.8)
        at, dx, dy = places[name]
        area.annotate(name, (at, np.interp(at, q, values)), (dx, dy), textcoords="offset points", color=letters(color), size=9,
                      arrowprops={"arrowstyle": "-", "color": LEADER, "lw": 0.8, "shrinkA": 1, "shrinkB": 2} if dx < -20 else None)
    area.set_xlim(0, 1)
    area.set_ylim(bottom=0)
    area.set_xlabel("q = distance / R")
    area.grid(axis="y", lw=0.5, color="#e6eaee")


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    q = np.linspace(0, 1, 401)
    check(q)
    made = figure(HEIGHT, "How much a neighbor counts, by its distance",
                  "Left: as density takes them, with an integral of 1 over space. Right: against their own value at 0, "
                  "as averages, normals and eigenvalues take them.", "", WIDTH)
    left = axes(made, 50, 50, 280, 180)
    plot(left, q, kernels(q), {"cubic": (0.32, 6, 4), "wendland2": (0.13, 6, 4), "poly6": (0.48, 8, 4), "tophat": (0.8, 0, 5)})
    left.set_ylabel("W R³")
    right = axes(made, 410, 50, 280, 180)
    shapes = [(name, values / values[0], color, dashes) for name, values, color, dashes in kernels(q)]
    shapes.append(("pca", 1 - q**3, BLACK, (0, (5, 1))))
    plot(right, q, shapes, {"cubic": (0.42, -80, -16), "wendland2": (0.46, -80, -24), "poly6": (0.45, 6, 3),
                            "tophat": (0.86, -10, 6), "pca": (0.72, 6, 2)})
    right.set_ylabel("W / W(0)", color=SOFT)
    right.set_ylim(0, 1.12)
    with open(sys.argv[1], "w", encoding="utf-8") as file:
        file.write(Chart("kernels", "Weights of neighbors by distance", made).svg())


if __name__ == "__main__":
    main()
