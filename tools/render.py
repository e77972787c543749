#!/usr/bin/env python3
"""Draws attributes of points, as `vdb_nns search --attributes` writes them, one picture each, side by side.

    tools/render.py IN --attribute NAME [--attribute NAME ...] -o OUT.png

IN is a .ply of `vdb_nns`, an .npz of `vdb_nns convert`, or the .npz of --attributes-output; the latter has no positions, which
--positions FILE gives (.ply, .npz, .npy). A name may leave out its prefix: density is nns_density. How a value is shown goes by what
it is:

    a number           viridis, with a bar
    cluster            a color for each of the largest, tints for the others, grey for noise
    a group            its points, and the others in grey
    normal             x, y and z as red, green and blue
    another vector     its length
    pca (stretch)      anisotropy, the longest axis over the shortest; with --ellipses the ellipsoids themselves

Needs NumPy, SciPy, Matplotlib and Pillow (tools/setup.sh --tests). exit: 0 done, 2 bad flags, 3 bad input
"""

import argparse
import os
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import EllipseCollection
from matplotlib.colors import LogNorm, Normalize, to_rgb
from matplotlib.lines import Line2D
from PIL import Image
from scipy.spatial import cKDTree

PAPER, INK, SOFT = "#10141c", "#f2f4f7", "#aab2bd"
OTHERS = "#4b535f"  # noise, points outside of a group, no normal
LARGEST = ("#56b4e9", "#e69f00", "#009e73")  # Okabe and Ito 2008
TINTS = ("#b8c9dc", "#d9cbb0", "#b4d4c9", "#d8b9cc", "#c6c2e0", "#dcd9b8")
LABELS = {
    "count": "neighbors",
    "density": "mass per volume",
    "mean_distance": "mean distance, world units",
    "nearest_distance": "distance of the nearest, world units",
    "nearest": "number of the nearest",
    "cluster_size": "points in the cluster",
}
PLY_TYPES = {"char": "i1", "uchar": "u1", "short": "<i2", "ushort": "<u2", "int": "<i4", "uint": "<u4", "float": "<f4",
             "double": "<f8"}
PLY_PARTS = (("x", "y", "z"), ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz"))


class BadInput(Exception):
    pass


# ---- files ---------------------------------------------------------------------------------------------------------


def read_ply(path):
    """Properties of the points of a binary .ply whose only element they are: name -> array."""
    with open(path, "rb") as file:
        lines = []
        while not lines or lines[-1] != "end_header":
            line = file.readline()
            if not line.endswith(b"\n") or len(lines) > 1000:
                raise BadInput(f"{path}: is no .ply, or its header has no end")
            lines.append(line.decode("ascii", "replace").strip())
        words = [line.split() for line in lines]
        elements = [line for line in words if line[:1] == ["element"]]
        if ["format", "binary_little_endian", "1.0"] not in words or [e[1] for e in elements] != ["vertex"]:
            raise BadInput(f"{path}: only binary little-endian points are read; "
                           "`vdb_nns convert IN.ply -o OUT.ply` makes such a file")
        properties = [line[1:] for line in words if line[:1] == ["property"]]
        kind = np.dtype([(name, PLY_TYPES[type]) for type, name in properties])
        rows = np.fromfile(file, kind)
    if len(rows) != int(elements[0][2]):
        raise BadInput(f"{path}: has {len(rows)} points instead of {elements[0][2]}")
    return join_parts({name: rows[name] for name in kind.names})


def join_parts(properties):
    """Properties NAME_x NAME_y NAME_z become one vector NAME, and nine NAME_xx ... a matrix."""
    arrays = {"positions": np.stack([properties.pop(axis) for axis in "xyz"], axis=-1)}
    if {"nx", "ny", "nz"} <= properties.keys():
        arrays["normal"] = np.stack([properties.pop(name) for name in ("nx", "ny", "nz")], axis=-1)
    for name in list(properties):
        for parts in PLY_PARTS:
            names = [name[: -len(parts[0]) - 1] + "_" + part for part in parts]
            if name == names[0] and all(one in properties for one in names):
                joined = np.stack([properties.pop(one) for one in names], axis=-1)
                arrays[name[: -len(parts[0]) - 1]] = joined.reshape(-1, 3, 3) if len(parts) == 9 else joined
    return {**arrays, **{name: values > 0 if values.dtype == np.uint8 else values for name, values in properties.items()}}


def read_arrays(path):
    extension = os.path.splitext(path)[1].lower()
    try:
        if extension == ".ply":
            return read_ply(path)
        if extension == ".npz":
            with np.load(path) as file:
                return {name: file[name] for name in file.files}
        if extension == ".npy":
            return {"positions": np.load(path)}
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror or error}") from error
    except (ValueError, KeyError) as error:
        raise BadInput(f"{path}: cannot be read: {error}") from error
    raise BadInput(f"{path}: give a .ply or an .npz; `vdb_nns convert IN.vdb -o OUT.ply` makes one")


def read_input(path, positions):
    arrays = read_arrays(path)
    if positions:
        arrays["positions"] = read_arrays(positions).get("positions")
    at = arrays.get("positions")
    if at is None or at.ndim != 2 or at.shape[1] != 3:
        raise BadInput(f"{positions or path}: has no positions; give a file that has by --positions")
    for name, values in arrays.items():
        if len(values) != len(at):
            raise BadInput(f"{path}: '{name}' has {len(values)} values for {len(at)} points")
    return arrays


def find(arrays, wanted, path):
    """The name in the file of an attribute that may lack its prefix."""
    wanted = "stretch" if wanted == "pca" else wanted
    names = [name for name in arrays if name != "positions"]
    for fits in (lambda name: name == wanted, lambda name: name.endswith("_" + wanted)):
        fitting = [name for name in names if fits(name)]
        if len(fitting) == 1:
            return fitting[0]
    there = ", ".join(sorted(names)) or "none"
    raise BadInput(f"{path}: has no attribute '{wanted}'; those there are: {there}")


# ---- colors --------------------------------------------------------------------------------------------------------


class Look:
    """Colors of the points, and what explains them: the norm of a bar, or marks of a legend, and a label."""

    def __init__(self, colors, label, norm=None, marks=(), colormap="viridis", extend="neither"):
        self.colors, self.label, self.norm, self.marks, self.colormap = colors, label, norm, marks, colormap
        self.extend = extend


def by_number(values, label, options, is_log=False, low=None, colormap="viridis"):
    values = values.astype(float)
    known = values[np.isfinite(values)]
    ends = np.percentile(known, (1, 99)) if known.size else (0, 1)
    low, high = options.range or (ends[0] if low is None else low, ends[1])
    if not low < high:
        low, high = low - 0.5, low + 0.5
    norm = LogNorm(max(low, 1), max(high, 10)) if is_log else Normalize(low, high)
    colors = matplotlib.colormaps[colormap](norm(np.clip(values, norm.vmin, norm.vmax)))[:, :3]
    colors[~np.isfinite(values)] = to_rgb(OTHERS)
    below, above = known.size and known.min() < norm.vmin, known.size and known.max() > norm.vmax
    extend = {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[int(below), int(above)]
    return Look(colors, label, norm, colormap=colormap, extend=extend)


def by_cluster(labels):
    colors = np.array([to_rgb(OTHERS)])[np.zeros(len(labels), int)]
    clusters, sizes = np.unique(labels[labels >= 0], return_counts=True)
    order = np.argsort(-sizes, kind="stable")
    palette = np.array([to_rgb(color) for color in TINTS])
    shown = palette[labels % len(palette)]
    marks = []
    for color, which in zip(LARGEST[: 2 if len(order) > 3 else 3], order):
        shown[labels == clusters[which]] = to_rgb(color)
        marks.append((color, thousands(sizes[which])))
    if len(order) > len(marks):
        marks.append((TINTS[0], f"{thousands(len(order) - len(marks))} more"))
    colors[labels >= 0] = shown[labels >= 0]
    if (labels < 0).any():
        marks.append((OTHERS, f"noise {thousands((labels < 0).sum())}"))
    return Look(colors, f"{thousands(len(order))} clusters, the largest by points", marks=marks)


def by_group(members, name):
    colors = np.array([to_rgb(OTHERS), to_rgb(LARGEST[1])])[members.astype(int)]
    return Look(colors, f"group {name}", marks=[(LARGEST[1], f"in it: {thousands(members.sum())}"),
                                                (OTHERS, f"others: {thousands((~members).sum())}")])


def by_direction(vectors):
    colors = np.clip(0.5 + 0.5 * vectors.astype(float), 0, 1)
    colors[~vectors.any(axis=1)] = to_rgb(OTHERS)
    ends = [("#ff8080", "+x"), ("#80ff80", "+y"), ("#8080ff", "+z"), (OTHERS, "none")]
    return Look(colors, "direction", marks=ends)


def look_of(name, values, options):
    known = (*LABELS, "cluster", "normal")
    bare = next((measure for measure in known if name == measure or name.endswith("_" + measure)), name)
    if values.dtype == bool:
        return by_group(values, name)
    if bare == "cluster" and values.dtype.kind == "i":
        return by_cluster(values)
    if bare == "normal" and values.ndim == 2:
        return by_direction(values)
    if name == "stretch" and values.ndim == 2:
        ratio = values.max(axis=1) / np.maximum(values.min(axis=1), 1e-30)
        return by_number(ratio, "longest over shortest axis", options, low=1, colormap="plasma")
    if values.ndim == 2:
        return by_number(np.linalg.norm(values.astype(float), axis=1), f"length of {name}", options)
    if values.ndim == 1:
        if bare in ("mean_distance", "nearest_distance", "nearest"):
            values = np.where(values < 0, np.nan, values)  # points without neighbors
        return by_number(values, LABELS.get(bare, name), options, is_log=bare == "cluster_size")
    raise BadInput(f"'{name}' has matrices, which have no color; take pca with --ellipses")


def thousands(number):
    return f"{number:,}".replace(",", " ")


# ---- drawing -------------------------------------------------------------------------------------------------------


def view_of(axis, up):
    """Unit vectors to the right, up and towards the eye."""
    up_vector = np.eye(3)["xyz".index(up)]
    toward = np.eye(3)["xyz".index(axis)] if axis != "oblique" else {
        "y": np.array([0.38, 0.5, 1.0]), "z": np.array([0.35, -1.0, 0.6]), "x": np.array([0.6, 0.35, 1.0])}[up]
    if axis == up:
        up_vector = np.eye(3)[("xyz".index(up) + 1) % 3]
    toward = toward / np.linalg.norm(toward)
    right = np.cross(up_vector, toward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(toward, right), toward])


def shade(colors, depth):
    """Far points a third of the way to the paper, so that one sees what is in front."""
    span = np.ptp(depth) or 1.0
    far = (0.35 * (depth.max() - depth) / span)[:, None]
    return colors * (1 - far) + np.array(to_rgb(PAPER)) * far


def spacing_of(positions):
    """Median distance to the nearest other point, of a sample."""
    if len(positions) < 2:
        return 1.0
    sample = positions[:: max(1, len(positions) // 2000)]
    return float(np.median(cKDTree(positions).query(sample, k=2)[0][:, 1])) or 1.0


def ellipses(arrays, chosen, view, size):
    """The outlines of ellipsoids: center, full axes and angle in the plane of the picture."""
    stretch, axes = (arrays[name][chosen].astype(float) for name in ("stretch", "xform"))
    columns = np.einsum("kc,ncj->nkj", view[:2], axes) * (size * stretch)[:, None, :]
    values, vectors = np.linalg.eigh(columns @ columns.transpose(0, 2, 1))
    lengths = 2 * np.sqrt(np.maximum(values, 0))
    return lengths[:, 1], lengths[:, 0], np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))


def draw_points(axes, arrays, look, view, chosen, options, diameter):
    at = arrays["pws" if options.ellipses and "pws" in arrays else "positions"][chosen].astype(float) @ view.T
    order = np.argsort(at[:, 2], kind="stable")
    at, colors = at[order], shade(look.colors[chosen][order], at[order, 2])
    axes.set_aspect("equal")
    axes.axis("off")
    low, high = at[:, :2].min(axis=0), at[:, :2].max(axis=0)
    margin = 0.01 * max(high - low) + diameter
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    if options.ellipses:
        width, height, angle = (part[order] for part in ellipses(arrays, chosen, view, options.ellipses))
        axes.add_collection(EllipseCollection(width, height, angle, units="xy", offsets=at[:, :2], facecolors=colors,
                                              edgecolors=PAPER, linewidths=0.4, transOffset=axes.transData))
        return
    # Markers are measured in points of the page.
    axes.figure.canvas.draw()
    points = 72 / axes.figure.dpi * (axes.transData.transform((diameter, 0)) - axes.transData.transform((0, 0)))[0]
    axes.scatter(at[:, 0], at[:, 1], c=colors, s=max(points, 0.8) ** 2, lw=0)


def explain(figure, place, look):
    """A bar or a legend below a picture."""
    if look.norm:
        bar = figure.colorbar(matplotlib.cm.ScalarMappable(look.norm, look.colormap), cax=place, orientation="horizontal",
                              extend=look.extend)
        bar.set_label(look.label, color=SOFT, fontsize=13)
        bar.ax.tick_params(colors=SOFT, labelsize=12)
        bar.outline.set_visible(False)
        return
    place.axis("off")
    marks = [Line2D([], [], marker="o", ls="", ms=8, color=color, label=text) for color, text in look.marks]
    place.legend(handles=marks, loc="center", ncol=len(marks), frameon=False, labelcolor=SOFT, fontsize=11, handletextpad=0,
                 columnspacing=0.8, bbox_to_anchor=(0.5, 1.0))
    place.text(0.5, -1.6, look.label, color=SOFT, fontsize=13, ha="center", transform=place.transAxes)


def draw(arrays, looks, options):
    view = view_of(options.axis, options.up)
    finite = np.isfinite(arrays["positions"]).all(axis=1)
    depth = np.where(finite[:, None], arrays["positions"], 0) @ view[2]
    if options.slice:
        finite &= (depth >= options.slice[0]) & (depth <= options.slice[1])
    flat = np.where(finite[:, None], arrays["positions"], 0) @ view[:2].T
    if options.window:
        left, right, bottom, top = options.window
        finite &= (flat >= (left, bottom)).all(axis=1) & (flat <= (right, top)).all(axis=1)
    if not finite.any():
        raise BadInput("no point is left to be drawn")
    across, height = np.maximum(np.ptp(flat[finite], axis=0), 1e-30)
    each = options.width / len(looks)
    picture = min(each * 0.94 * height / across, 1.6 * each)
    head, foot = 34, 74  # pixels, for the title and for the bar
    full = picture + head + foot
    figure = plt.figure(figsize=(options.width / 100, full / 100), dpi=100, facecolor=PAPER)
    diameter = options.size or 1.1 * spacing_of(arrays["positions"][finite])
    for place, (title, look) in enumerate(looks):
        left = place / len(looks)
        axes = figure.add_axes([left + 0.03 / len(looks), foot / full, 0.94 / len(looks), picture / full])
        draw_points(axes, arrays, look, view, finite, options, diameter)
        bar = figure.add_axes([left + 0.12 / len(looks), (foot - 20) / full, 0.76 / len(looks), 12 / full])
        explain(figure, bar, look)
        figure.text(left + 0.5 / len(looks), 1 - 10 / full, title, color=INK, fontsize=16, weight="bold", ha="center", va="top")
    figure.savefig(options.output, facecolor=PAPER)
    plt.close(figure)
    # A palette keeps the file small.
    Image.open(options.output).convert("RGB").quantize(options.colors, kmeans=2, dither=Image.Dither.NONE).save(options.output,
                                                                                                     optimize=True)


def parse():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("input", metavar="IN", help=".ply or .npz with attributes")
    parser.add_argument("--attribute", metavar="NAME", action="append", required=True,
                        help="what is drawn; several are drawn side by side")
    parser.add_argument("-o", "--output", metavar="PNG", required=True, help="the picture to write")
    parser.add_argument("--positions", metavar="FILE", help="file with the positions, where IN has none")
    parser.add_argument("--axis", choices=("oblique", "x", "y", "z"), default="oblique",
                        help="axis towards the eye; oblique: from above, in front and the right")
    parser.add_argument("--up", choices=("x", "y", "z"), default="y", help="axis that points up in the picture")
    parser.add_argument("--slice", metavar=("FROM", "TO"), type=float, nargs=2,
                        help="only points so far along the line of sight, world units: with --axis z those z")
    parser.add_argument("--window", metavar=("LEFT", "RIGHT", "BOTTOM", "TOP"), type=float, nargs=4,
                        help="only points in that part of the picture, world units: with --axis z those x and y")
    parser.add_argument("--range", metavar=("LOW", "HIGH"), type=float, nargs=2,
                        help="numbers at the ends of the bars; default: the 1st and the 99th percentile")
    parser.add_argument("--ellipses", metavar="SIZE", type=float,
                        help="draw the ellipsoids of pca, of that radius in world units where they are not stretched")
    parser.add_argument("--size", metavar="D", type=float, help="diameter of a point, world units; default: 1.1 spacings")
    parser.add_argument("--width", metavar="PIXELS", type=int, default=1320, help="of the whole picture")
    parser.add_argument("--colors", metavar="N", type=int, default=256, help="colors of the file, up to 256")
    options = parser.parse_args()
    if not options.output.lower().endswith(".png"):
        parser.error(f"-o: '{options.output}' does not end in .png")
    if options.range and not options.range[0] < options.range[1]:
        parser.error("--range: LOW is not below HIGH")
    if not 2 <= options.colors <= 256 or options.width < 100:
        parser.error("--colors: give 2 to 256; --width: give 100 or more")
    return options


def main():
    options = parse()
    try:
        arrays = read_input(options.input, options.positions)
        if options.ellipses:
            for name in ("stretch", "xform"):
                find(arrays, name, options.input)
        looks = []
        for wanted in options.attribute:
            name = find(arrays, wanted, options.input)
            title = "anisotropy" if name == "stretch" else wanted
            looks.append((title, look_of(name, arrays[name], options)))
        draw(arrays, looks, options)
    except BadInput as error:
        print(f"render.py: {error}", file=sys.stderr)
        return 3
    print(f"{options.output}: {len(arrays['positions'])} points, {os.path.getsize(options.output)} bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
