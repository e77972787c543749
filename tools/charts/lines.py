"""Panels side by side, and lines in them with names at their ends: for the charts of budgets and scaling."""

from charts import labels
from charts.style import FOOTER, LEADER, LINES, RULE, SOFT, WIDTH, axes, figure, letters, shorten, text_width

LEFT, RIGHT, TOP, BOTTOM = 58, 14, 62, 38  # points around the axes of a panel; TOP is of the figure
HEAD = 26  # points for the title of a panel


class Panels:
    """A figure with panels in columns; each panel is axes on top of one another with a common x."""

    def __init__(self, titles, heights, words, machine, columns=2):
        """@param heights of the axes in a panel from top to bottom; @param words (title, subtitle)"""
        columns = min(columns, len(titles))
        rows = -(-len(titles) // columns)
        self.heights, gap = heights, 22
        panel = HEAD + sum(heights) + gap * (len(heights) - 1) + BOTTOM
        total = TOP + 13 * words[1].count("\n") - 10 + rows * panel + FOOTER
        self.figure = figure(total, *words, machine)
        self.width = (WIDTH if columns > 1 else WIDTH * 0.72) / columns - LEFT - RIGHT
        self.areas = []
        for at, title in enumerate(titles):
            left = LEFT + (at % columns) * (self.width + LEFT + RIGHT)
            top = FOOTER + (rows - at // columns) * panel
            self.figure.text(
                (left - 4) / WIDTH,
                (top - 12) / total,
                shorten(title, self.width, 9.5, "bold"),
                size=9.5,
                weight="bold",
                va="center",
            )
            self.areas.append(self._stack(left, top - HEAD, gap))

    def _stack(self, left, top, gap):
        stack = []
        for height in self.heights:
            top -= height
            stack.append(axes(self.figure, left, top, self.width, height))
            top -= gap
        return stack


def grid(area, scale):
    for place, _ in scale.ticks():
        area.axhline(place, color=RULE, lw=0.6, zorder=0)


def room_for(names):
    """Points that names at the ends of lines need."""
    return min(max([text_width(name, 8) for name in names], default=0), 120) + 18


def style_of(names):
    """Color, marker and dashes of every name, the same in all panels of a chart."""
    return {name: LINES[at % len(LINES)] for at, name in enumerate(dict.fromkeys(names))}


def draw_lines(area, lines, across, up, styles, hollow=False):
    """Draws {name: [(x, y)]} and puts the names at the right ends."""
    ends = []
    for name, points in lines.items():
        places = [(across.at(x), up.at(y)) for x, y in sorted(points)]
        if not places:
            continue
        color, marker, dashes = styles[name]
        area.plot([x for x, _ in places], [y for _, y in places], color=color, ls=dashes, lw=1.4, zorder=3)
        area.plot(
            [x for x, _ in places],
            [y for _, y in places],
            color=color,
            ls="none",
            marker=marker,
            ms=5,
            mfc="white" if hollow else color,
            mew=1.1,
            zorder=4,
            clip_on=False,
        )
        ends.append((name, max(places), color))
    heights = labels.spread([place[1] for _, place, _ in ends], 4, up.length, gap=labels.HEIGHT)
    for (name, place, color), y in zip(ends, heights):
        label = labels.Label(name, *place, widest=120)
        label.put(place[0] + 10, y)
        labels.draw(area, label, letters(color), LEADER)


def note(area, across, up, words):
    area.text(across.length / 2, up.length / 2, words, color=SOFT, ha="center", va="center")
