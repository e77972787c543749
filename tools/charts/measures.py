"""Chart of the study of measures: error against time of every method, a panel for each measure of a scene."""

from charts import labels
from charts.lines import Panels, grid, style_of
from charts.report import number, text, typical
from charts.scale import BrokenLog, Linear
from charts.style import BAND, LEADER, Chart, file_names, letters, plain, short

HEIGHT = 190  # points of a panel
ZERO = 16  # points for errors of 0

# (measure, the error in the accuracy of its rows, title, what the error is)
PANELS = (
    ("density", (), "density", "relative error"),
    ("normal", (), "normal", "error, degrees"),
    ("pca", (), "pca: lengths of the axes", "relative error"),
    ("pca", ("axis",), "pca: direction of the longest axis", "error, degrees"),
)


class Point:
    """A method in a panel: times of counting, the error's root mean square, and its largest."""

    def __init__(self, row, path):
        self.name = text(row, "method")
        self.time = number(row, "ratio")
        self.rms = number(row, "accuracy", *path, "rms")
        self.most = number(row, "accuracy", *path, "max")

    def drawable(self):
        known = self.rms is not None and self.most is not None and self.time is not None
        return known and self.time > 0 and 0 <= self.rms <= self.most


def charts(report, machine):
    """One chart a scene."""
    names = file_names(dict.fromkeys(report.scenes("measures")))
    made = [_chart(scene, names[scene], report.of("measures", scene), machine) for scene in names]
    return [chart for chart in made if chart]


def _chart(scene, name, rows, machine):
    panels = [
        (title, words, [Point(row, path) for row in rows if text(row, "measure") == measure])
        for measure, path, title, words in PANELS
    ]
    panels = [
        (title, words, [point for point in points if point.drawable()]) for title, words, points in panels
    ]
    panels = [panel for panel in panels if panel[2]]
    if not panels:
        return None
    title = f"{scene}: measures, error against time"
    made = Panels([panel[0] for panel in panels], [HEIGHT], (title, _subtitle(rows)), machine)
    styles = style_of(text(row, "method") for row in rows)
    for areas, (_, words, points) in zip(made.areas, panels):
        _draw(areas[0], points, words, made.width, styles)
    return Chart("measures-" + name, title, made.figure)


def _subtitle(rows):
    first = typical(rows)
    checked, points = number(first, "accuracy", "checked_queries"), number(first, "points")
    whole = isinstance(first.get("accuracy"), dict) and first["accuracy"].get("complete") is True
    names = dict.fromkeys(text(row, "method") for row in rows if not any(
        Point(row, path).drawable() for measure, path, _, _ in PANELS if measure == text(row, "measure")))
    left_out = "\nnot drawn, for they have no time or were not checked: " + ", ".join(names) if names else ""
    return (
        f"{short(points)} particles · against formulas in long double over the exact neighbors of "
        f"{'all' if whole else plain(checked)} particles\n"
        f"marks: root mean square · bars: up to the largest error · medians of {plain(number(first, 'runs'))} runs{left_out}"
    )


def _draw(area, points, words, width, styles):
    values = [value for point in points for value in (point.rms, point.most)]
    zero = ZERO if min(values) == 0 else 0
    across = Linear([point.time for point in points], width, low=0, room=30)
    up = BrokenLog(values, HEIGHT, zero=zero, pad=0.05)
    across.on_axis(area, "x")
    up.on_axis(area, "y")
    if zero:
        area.axhspan(0, zero, color=BAND, lw=0, zorder=0)
    grid(area, up)
    area.set_ylabel(words + ", logarithmic")
    area.set_xlabel("time of the pass / time of counting alone")
    made, bars = [], []
    for point in points:
        x, y, top = across.at(point.time), up.at(point.rms), up.at(point.most)
        color, marker, _ = styles[point.name]
        area.plot([x, x], [y, top], color=color, lw=1, zorder=3)
        area.plot([x - 3, x + 3], [top, top], color=color, lw=1, zorder=3)
        area.plot(x, y, marker=marker, ms=6.5, color=color, ls="none", zorder=4, clip_on=False)
        made.append(labels.Label(point.name, x, y, weight="bold" if point.name == "ours" else "normal"))
        bars.append((x - 4, y + labels.CLEAR + 1, x + 4, top + 2))
    labels.place_around(made, (2, 2, width, HEIGHT), boxes=bars)
    for point, label in zip(points, made):
        labels.draw(area, label, letters(styles[point.name][0]), LEADER)
