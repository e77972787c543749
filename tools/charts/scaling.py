"""Line charts of how time grows with particles, threads, radius and clustering, one chart for each."""

from charts.lines import Panels, draw_lines, grid, room_for, style_of
from charts.report import divide, nanoseconds_per_neighbor, number, text
from charts.scale import BrokenLog, Linear, tick
from charts.style import RULE, Chart

HEIGHT, WRONG = 190, 80  # points

# vary: (title, how to read it, x, y)
KINDS = {
    "points": (
        "More particles",
        "time of one particle against their number; a level line means the time grows as the number does",
        "particles, logarithmic",
        "ns per particle, logarithmic",
    ),
    "threads": (
        "More threads",
        "how many times as fast as with the fewest threads that were run; the grey line is the ideal",
        "threads, logarithmic",
        "speed-up, logarithmic",
    ),
    "radius": (
        "A larger radius",
        "time of one neighbor found against the radius; it falls where the work per cell is shared by more",
        "radius, world units, logarithmic",
        "ns per neighbor, logarithmic",
    ),
    "clustering": (
        "More clustered",
        "time of one neighbor found, and wrong pairs, while the particles gather",
        "clustering (0: even)",
        "ns per neighbor, logarithmic",
    ),
}


def charts(report, machine):
    """A chart for each thing that was varied, with a panel per scene."""
    return [chart for vary in KINDS for chart in _charts(report, vary, machine)]


def series(report, vary):
    """{scene: {method: [row]}} of rows with a value, by value."""
    found = {}
    for row in report["scaling"]:
        if row.get("vary") == vary and number(row, "value") is not None:
            found.setdefault(text(row, "scene"), {}).setdefault(text(row, "method"), []).append(row)
    for methods in found.values():
        for rows in methods.values():
            rows.sort(key=lambda row: number(row, "value"))
    return found


def _charts(report, vary, machine):
    found = {
        scene: {
            method: points
            for method, points in ((method, _points(rows, vary)) for method, rows in methods.items())
            if points
        }
        for scene, methods in series(report, vary).items()
    }
    found = {scene: lines for scene, lines in found.items() if lines}
    if not found:
        return []
    title, how, x_words, y_words = KINDS[vary]
    wrong = {scene: _wrong(methods) for scene, methods in series(report, vary).items()}
    with_wrong = vary == "clustering" and any(any(lines.values()) for lines in wrong.values())
    panels = Panels(list(found), [HEIGHT, WRONG] if with_wrong else [HEIGHT], (title, how), machine)
    styles = style_of(text(row, "method") for row in report["scaling"])
    every = [point for lines in found.values() for points in lines.values() for point in points]
    across = _x_scale(
        vary,
        [x for x, _ in every],
        panels.width,
        room_for(method for lines in found.values() for method in lines),
    )
    ideal = [max(x for x, _ in every) / min(x for x, _ in every)] if vary == "threads" else []
    up = BrokenLog([y for _, y in every] + ideal, HEIGHT)
    for areas, (scene, lines) in zip(panels.areas, found.items()):
        across.on_axis(
            areas[0], "x", ticks=_x_ticks(vary, across, [x for points in lines.values() for x, _ in points])
        )
        up.on_axis(areas[0], "y")
        grid(areas[0], up)
        areas[0].set_ylabel(y_words)
        areas[-1].set_xlabel(x_words)
        if vary == "threads":
            _draw_ideal(areas[0], across, up, [x for x, _ in every])
        draw_lines(areas[0], lines, across, up, styles)
        if with_wrong:
            _draw_wrong(areas[1], wrong, scene, across, styles)
    return [Chart("scaling-" + vary, title, panels.figure)]


def _points(rows, vary):
    """[(value, y)] where both are known and y can be on a logarithm."""
    base = next((row for row in rows if number(row, "seconds", "total")), None)
    points = []
    for row in rows:
        seconds = number(row, "seconds", "total")
        if vary == "points":
            y = divide(seconds, number(row, "points"), 1e9)
        elif vary == "threads":
            y = divide(number(base, "seconds", "total"), seconds) if base else None
        else:
            y = nanoseconds_per_neighbor(row)
        if y is not None and y > 0 and (vary == "clustering" or number(row, "value") > 0):
            points.append((number(row, "value"), y))
    return points


def _wrong(methods):
    """{method: [(value, wrong pairs per million)]}"""
    return {
        method: [
            (number(row, "value"), number(row, "wrong_per_million"))
            for row in rows
            if number(row, "wrong_per_million") is not None
        ]
        for method, rows in methods.items()
    }


def _x_scale(vary, values, length, room):
    if vary == "clustering":
        return Linear(values, length, room=room)
    return BrokenLog(values, length, room=room)


def _x_ticks(vary, across, values):
    """Threads are labeled where they were run; elsewhere round values will do."""
    if vary != "threads":
        return None
    return [(across.at(value), tick(value)) for value in sorted(set(values))]


def _draw_ideal(area, across, up, threads):
    low, high = min(threads), max(threads)
    area.plot([across.at(low), across.at(high)], [up.at(1), up.at(high / low)], color=RULE, lw=4, zorder=1)


def _draw_wrong(area, wrong, scene, across, styles):
    every = [y for lines in wrong.values() for points in lines.values() for _, y in points]
    up = BrokenLog(every, WRONG, zero=22)
    across.on_axis(area, "x")
    up.on_axis(area, "y", ticks=up.ticks(3))
    area.set_ylabel("wrong per million")
    draw_lines(
        area, {name: points for name, points in wrong[scene].items() if name in styles}, across, up, styles
    )
