"""Chart B: the error of estimators of the work against their time."""

from charts import labels
from charts.lines import Panels, grid
from charts.report import divide, number, pareto, text
from charts.scale import BrokenLog
from charts.style import BLACK, BLUE, GREEN, INK, LEADER, ORANGE, PURPLE, SKY, SOFT, VERMILION, Chart, plain

FAMILIES = {
    "paper": ("o", BLUE),
    "uncorrected": ("v", SKY),
    "expected": ("s", GREEN),
    "sampled": ("D", ORANGE),
    "counted": ("P", VERMILION),
    "fixed": ("^", PURPLE),
    "mask": ("X", BLACK),
}
HEIGHT = 230
SMALLEST = 1e-3  # per cent of error; less is rounding, or a scene of one block


def charts(report, machine):
    """One chart with a panel per scene; all share their scales."""
    found = {
        scene: [point for point in map(_point, report.of("estimators", scene)) if point]
        for scene in report.scenes("estimators")
    }
    found = {scene: points for scene, points in found.items() if points}
    if not found:
        return []
    every = [point for points in found.values() for point in points]
    words = (
        "Estimators: error against time",
        "up to which relative error the expected pairs of 99 % of the blocks are right, "
        "against the time it takes · "
        "low and left is good\nthe line joins those that no other beats in both · below 0.001 % is drawn at 0",
    )
    panels = Panels([_title(report, scene) for scene in found], [HEIGHT], words, machine)
    zeros = [36 if any(point[axis] <= 0 for point in every) else 0 for axis in (1, 2)]
    across = BrokenLog([point[1] for point in every], panels.width, zeros[0], room=40)
    up = BrokenLog([point[2] for point in every], HEIGHT, zeros[1] / 1.5)
    for (area,), points in zip(panels.areas, found.values()):
        across.on_axis(area, "x")
        up.on_axis(area, "y")
        grid(area, up)
        area.set_xlabel("time of the estimate, % of a full count, logarithmic")
        area.set_ylabel("99th percentile of error, %, logarithmic")
        _draw(area, points, across, up)
    return [Chart("estimators", words[0], panels.figure)]


def _point(row):
    """(name, time in % of a count, p99 error in %), None where either is unknown."""
    time = divide(number(row, "seconds"), number(row, "count_seconds"), 100)
    error = number(row, "p99")
    if time is None or error is None:
        return None
    return text(row, "estimator"), time, 100 * error if 100 * error >= SMALLEST else 0


def _title(report, scene):
    blocks = number(report.of("estimators", scene)[0], "blocks")
    return scene if blocks is None else f"{scene} · {plain(blocks)} blocks"


def _draw(area, points, across, up):
    places = [(across.at(time), up.at(error)) for _, time, error in points]
    front = pareto([(time, -error) for _, time, error in points])
    stairs = []
    for place in sorted(place for place, is_front in zip(places, front) if is_front):
        if stairs:
            stairs.append((place[0], stairs[-1][1]))
        stairs.append(place)
    area.plot([x for x, _ in stairs], [y for _, y in stairs], color=INK, lw=1, alpha=0.5, zorder=1)
    made = []
    for (name, _, _), place, is_front in zip(points, places, front):
        marker, color = FAMILIES.get(name.split(":")[0], ("h", SOFT))
        area.plot(*place, marker=marker, ms=6.5, color=color, ls="none", zorder=4, clip_on=False)
        made.append(labels.Label(name, *place, weight="bold" if is_front else "normal"))
    labels.place_around(made, (2, 3, across.length, up.length), lines=list(zip(stairs, stairs[1:])))
    for label, is_front in zip(made, front):
        labels.draw(area, label, INK if is_front else SOFT, LEADER)
