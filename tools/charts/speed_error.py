"""Chart A: speed against error of every method on one scene, with the Pareto front.

The left column is "no wrong pair"; a logarithm of wrong pairs per million lies right of it. Methods whose
seconds come from a model of a device are hollow and take no part in the front: a computed time beats nobody;
neither do those that make no lists.
"""

from charts import labels
from charts.report import (
    divide,
    has_lists,
    is_model,
    is_sampled,
    million_per_second,
    number,
    pareto,
    text,
    typical,
    wrong_per_million,
)
from charts.scale import BrokenLog
from charts.style import (
    BAND,
    BLACK,
    BLUE,
    FAINT,
    FOOTER,
    GREEN,
    INK,
    LEADER,
    ORANGE,
    PURPLE,
    RULE,
    SOFT,
    VERMILION,
    WIDTH,
    Chart,
    axes,
    figure,
    file_names,
    plain,
    short,
    text_width,
)

KINDS = {
    "engine": ("the engine, CPU", "o", BLUE),
    "device": ("the engine, devices", "s", GREEN),
    "part": ("a part left out", "^", ORANGE),
    "approximate": ("approximate on purpose", "D", VERMILION),
    "peer": ("another library", "P", PURPLE),
    "": ("other", "X", BLACK),
}
GREY, GREY_TEXT = "#b3b9c0", "#6e7781"
LEFT, RIGHT, TOP, BOTTOM = 58, 14, 78, 40  # points around the axes


class Point:
    """A method on the plane."""

    def __init__(self, result):
        self.name, self.model = text(result, "method"), is_model(result)
        self.lists = has_lists(result)
        kind = text(result, "kind")
        self.kind = kind if kind in KINDS else ""
        self.wrong, self.speed = wrong_per_million(result), million_per_second(result)
        # The slowest run has the lowest speed.
        self.low = million_per_second(result, "max") or self.speed
        self.high = million_per_second(result, "min") or self.speed
        self.front = False

    def drawable(self):
        return self.wrong is not None and self.speed is not None and self.speed > 0

    def words(self):
        return self.name + (" (model)" if self.model else "") + ("" if self.lists else " (no lists)")


def mark_front(points):
    """Finds the measured points with lists that no other of them beats."""
    measured = [point for point in points if point.lists and not point.model]
    for point, is_front in zip(measured, pareto([(point.wrong, point.speed) for point in measured])):
        point.front = is_front


def charts(report, machine):
    """One chart per scene; all share their scales, so that they can be compared."""
    of_scene = {
        scene: [Point(result) for result in report.of("results", scene)] for scene in report.scenes("results")
    }
    every = [point for points in of_scene.values() for point in points if point.drawable()]
    if not every:
        return []
    names = file_names(of_scene)
    return [
        _chart((scene, names[scene]), report.of("results", scene), points, every, machine)
        for scene, points in of_scene.items()
        if any(point.drawable() for point in points)
    ]


def _chart(names, results, points, every, machine):
    scene, name = names
    shown = [point for point in points if point.drawable()]
    mark_front(shown)
    exact = [point for point in shown if point.wrong == 0]
    tallest = max(
        sum(point.wrong == 0 for point in every) * 0.62 * labels.HEIGHT, len(shown) - len(exact), 250
    )
    height = min(tallest, 640)
    subtitle = _subtitle(results, points)
    top = TOP + 13 * subtitle.count("\n")
    made = figure(height + top + BOTTOM + FOOTER, f"{scene}: speed against error", subtitle, machine)
    area = axes(made, LEFT, BOTTOM + FOOTER, WIDTH - LEFT - RIGHT, height)
    width = WIDTH - LEFT - RIGHT
    across = BrokenLog(
        [point.wrong for point in every], width, _column_width(every, width), pad=0.08, room=60
    )
    up = BrokenLog(
        [value for point in every for value in (point.speed, point.low, point.high)], height, pad=0.08
    )
    _draw_plane(area, across, up, any(is_sampled(result) for result in results))
    right = "some wrong pairs" if len(exact) < len(shown) else "some wrong pairs: no method here"
    area.text(width, height - 4, right, size=8, color=FAINT, ha="right", va="top")
    places = _places(shown, across, up)
    stairs = _draw_front(area, shown, places, width)
    for point in shown:
        _draw_marker(area, point, places[point], up)
    _label_column(area, exact, places, across, height, stairs)
    bars = [((places[point][0], up.at(point.low)), (places[point][0], up.at(point.high))) for point in shown]
    _label_rest(
        area,
        [point for point in shown if point.wrong > 0],
        places,
        (across.zero, width, height),
        stairs + bars,
    )
    _legend(area, shown, height)
    return Chart("speed-error-" + name, f"{scene}: speed against error", made)


def _subtitle(results, points):
    first = typical(results)
    facts = [
        ("{} particles", plain(number(first, "points"))),
        ("{} neighbors each", plain(divide(number(first, "pairs"), number(first, "points")))),
        ("radius {}", short(number(first, "radius"))),
        ("{} threads", plain(number(first, "threads"))),
    ]
    scene = [words.format(value) for words, value in facts if value != "–"]
    checked = [number(result, "accuracy", "checked_queries") for result in results if is_sampled(result)]
    checked = [value for value in checked if value is not None]
    check = (
        f"accuracy from a sample of {plain(min(checked))} queries: 0 means none wrong among these"
        if checked
        else "accuracy of every query"
    )
    lines = [
        " · ".join(scene),
        f"medians of {plain(number(first, 'runs'))} runs, bars from the slowest to the fastest · {check}",
    ]
    left_out = [point.name for point in points if not point.drawable()]
    if left_out:
        lines.append("not drawn, for they have no time or were not checked: " + ", ".join(left_out))
    return "\n".join(lines)


def _column_width(points, width):
    """As wide as labels on both sides need, at most 55 % of all."""
    exact = [point for point in points if point.wrong == 0]
    widest = max([text_width(point.words(), 8, "bold") for point in exact] + [60])
    return min(2 * (min(widest, 150) + 46), 0.55 * width)


def _draw_plane(area, across, up, sampled):
    across.on_axis(area, "x", zero_label="0 in the sample" if sampled else "0: exact")
    up.on_axis(area, "y")
    area.axvspan(0, across.zero, color=BAND, lw=0, zorder=0)
    for place, _ in up.ticks():
        area.axhline(place, color=RULE, lw=0.6, zorder=0)
    area.set_xlabel("wrong pairs (missing + extra) per million true pairs, logarithmic", size=8.5)
    area.set_ylabel("million particles per second, logarithmic", size=8.5)
    area.text(across.zero / 2, up.length - 4, "no wrong pair", size=8, color=FAINT, ha="center", va="top")


def _places(points, across, up):
    """Of every point in points; in the exact column they step aside for one another."""
    exact = sorted(
        (point for point in points if point.wrong == 0), key=lambda point: (-point.speed, point.name)
    )
    steps = dict(zip(exact, labels.dodge([up.at(point.speed) for point in exact], 9)))
    return {
        point: (across.at(point.wrong) + 10 * steps.get(point, 0), up.at(point.speed)) for point in points
    }


def _draw_front(area, points, places, width):
    """The stairs of the best speed at every error; their segments."""
    front = sorted((point for point in points if point.front), key=lambda point: (point.wrong, point.speed))
    corners = []
    for at, point in enumerate(front):
        if at:
            corners.append((places[point][0], places[front[at - 1]][1]))
        corners.append(places[point])
    if front:
        corners.append((width, places[front[-1]][1]))
    area.plot([x for x, _ in corners], [y for _, y in corners], color=INK, lw=1.1, alpha=0.55, zorder=1)
    return list(zip(corners, corners[1:]))


def _draw_marker(area, point, place, up):
    _, marker, color = KINDS[point.kind]
    edge = color if point.front or point.model or not point.lists else GREY
    area.plot([place[0]] * 2, [up.at(point.low), up.at(point.high)], color=edge, lw=1, zorder=3)
    area.plot(
        *place,
        marker=marker,
        ms=6.5 if marker != "o" else 7,
        mfc="white" if point.model else edge,
        mec=edge,
        mew=1.2,
        ls="none",
        zorder=5 if point.front else 4,
        clip_on=False,
    )


def _style(point):
    if point.front:
        return {"weight": "bold"}, {"color": INK, "leader_color": SOFT}
    return {}, {"color": INK if point.model else GREY_TEXT, "leader_color": LEADER}


def _label_column(area, points, places, across, height, stairs):
    """Left and right of the column, in the order of the markers; the front's line stays free."""
    middle = across.zero / 2
    reach = max([12] + [abs(places[point][0] - middle) + 11 for point in points])
    half = middle - reach - 8
    sides = {"left": [], "right": []}
    for point in sorted(points, key=lambda point: (-places[point][1], places[point][0])):
        offset = places[point][0] - middle
        lesser = "left" if len(sides["left"]) <= len(sides["right"]) else "right"
        sides["left" if point.front or offset < -1 else "right" if offset > 1 else lesser].append(point)
    line = [start[1] for start, _ in stairs[:1] if start[0] <= across.zero]
    for side, members in sides.items():
        made = [
            labels.Label(point.words(), *places[point], widest=half, **_style(point)[0]) for point in members
        ]
        if side == "right" and line:
            above = [label for label in made if label.y > line[0] + 2]
            below = [label for label in made if label.y <= line[0] + 2]
            heights = labels.spread([label.y for label in above], line[0] + 9, height - 20)
            heights += labels.spread([label.y for label in below], 6, line[0] - 8)
            made = above + below
            members = sorted(members, key=lambda point: places[point][1] <= line[0] + 2)
        else:
            heights = labels.spread([label.y for label in made], 6, height - 20)
        for point, label, y in zip(members, made, heights):
            label.put(middle + reach if side == "right" else middle - reach - label.width, y)
            labels.draw(area, label, **_style(point)[1])


def _label_rest(area, points, places, bounds, lines):
    left, right, top = bounds
    made = [labels.Label(point.words(), *places[point], **_style(point)[0]) for point in points]
    labels.place_around(made, (left + 3, 4, right, top - 16), lines=lines)
    for point, label in zip(points, made):
        labels.draw(area, label, **_style(point)[1])


def _legend(area, points, height):
    """Shapes in one row over the axes."""
    kinds = [kind for kind in KINDS if any(point.kind == kind for point in points)]
    entries = [(KINDS[kind][0], KINDS[kind][1], KINDS[kind][2], True) for kind in kinds]
    entries.append(("another beats it", "o", GREY, True))
    if any(point.model for point in points):
        entries.append(("hollow: time of a model", "o", SOFT, False))
    x, y = 4, height + 16
    for words, marker, color, is_filled in entries:
        area.plot(
            x,
            y,
            marker=marker,
            ms=6,
            mfc=color if is_filled else "white",
            mec=color,
            mew=1.2,
            ls="none",
            clip_on=False,
        )
        area.text(x + 8, y, words, size=8, color=SOFT, va="center_baseline")
        x += text_width(words, 8) + 26
    area.plot([x - 3, x + 9], [y, y], color=INK, lw=1.1, alpha=0.55, clip_on=False)
    area.text(x + 14, y, "Pareto front", size=8, color=SOFT, va="center_baseline")
