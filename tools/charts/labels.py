"""Labels that do not lie on one another: in a column beside their markers, or freely around them.

Everything is in points of one axes rectangle, x to the right and y up. The same input gives the same places.
"""

import math

from charts.style import shorten, text_width

HEIGHT = 10.5  # of a line of a label, with air
CLEAR = 6.0  # half the side of the square that a marker keeps free


class Label:
    """A text at (x, y) that ends up in the box (left, bottom, right, top)."""

    def __init__(self, words, x, y, size=8, weight="normal", widest=150):
        self.words = shorten(words, widest, size, weight)
        self.x, self.y, self.size, self.weight = x, y, size, weight
        self.width = text_width(self.words, size, weight)
        self.box = None

    def put(self, left, middle):
        self.box = (left, middle - HEIGHT / 2, left + self.width, middle + HEIGHT / 2)

    def nearest(self):
        """The point of the box where a leader line ends."""
        left, bottom, right, top = self.box
        middle = (bottom + top) / 2
        if self.x < left:
            return left - 1.5, middle
        if self.x > right:
            return right + 1.5, middle
        return min(max(self.x, left), right), bottom if self.y < bottom else top


def spread(wanted, low, high, gap=HEIGHT):
    """Places as near to the wanted ones as a gap between neighbors allows, in [low, high] if possible.

    The pools of the least-squares isotonic fit: what collides moves as one.
    """
    order = sorted(range(len(wanted)), key=lambda i: (wanted[i], i))
    pools = []  # [sum of (wanted - offset), members]
    for rank, i in enumerate(order):
        pools.append([wanted[i] - rank * gap, [i]])
        while len(pools) > 1 and _mean(pools[-2]) >= _mean(pools[-1]):
            total, members = pools.pop()
            pools[-1][0] += total
            pools[-1][1] += members
    places, rank = [0.0] * len(wanted), 0
    last = high - (len(wanted) - 1) * gap
    for pool in pools:
        start = max(min(_mean(pool), last), low)
        for i in pool[1]:
            places[i] = start + rank * gap
            rank += 1
    return places


def _mean(pool):
    return pool[0] / len(pool[1])


def dodge(heights, distance):
    """Sideways steps (0, 1, -1, 2 ...) so that markers of one column do not lie on one another."""
    steps, placed = [], []
    for height in heights:
        for step in sorted(range(-9, 10), key=lambda s: (abs(s), -s)):
            if all(other != step or abs(at - height) >= distance for at, other in placed):
                break
        steps.append(step)
        placed.append((height, step))
    return steps


def place_around(labels, bounds, boxes=(), lines=()):
    """Puts every label near its marker: first greedily from the crowds on, then each once more.

    @param bounds (left, bottom, right, top) that labels stay in
    @param boxes  areas to keep free, beside the markers
    @param lines  ((x, y), (x, y)) better not covered
    """
    markers = [(label.x - CLEAR, label.y - CLEAR, label.x + CLEAR, label.y + CLEAR) for label in labels]
    crowd = [sum(math.hypot(a.x - b.x, (a.y - b.y) * 3) < 90 for b in labels) for a in labels]
    order = sorted(range(len(labels)), key=lambda i: (-crowd[i], i))
    for _ in range(3):
        for i in order:
            others = [other for other in labels if other is not labels[i] and other.box]
            free = [box for at, box in enumerate(markers) if at != i] + list(boxes)
            labels[i].put(*_best_place(labels[i], bounds, others, free, lines))


def _best_place(label, bounds, others, boxes, lines):
    least, best = math.inf, None
    for place in sorted(_candidates(label), key=lambda place: place[2]):
        if place[2] >= least:
            break
        cost = _cost(label, place, bounds, others, boxes, lines)
        if cost < least:
            least, best = cost, place[:2]
    return best


def _candidates(label):
    """Boxes at growing distance in 16 directions, as (left, middle, cost); right is best, then left."""
    for distance in (9, 13, 18, 25, 34, 45, 58, 74, 94, 118):
        for turn in range(16):
            angle = math.tau * turn / 16
            across, up = math.cos(angle), math.sin(angle)
            left = label.x + across * distance - label.width * (1 - across) / 2
            cost = distance + (0 if turn == 0 else 2 if turn == 8 else 5)
            yield left, label.y + up * (distance + (1 - abs(across)) * 2), cost


def _cost(label, place, bounds, others, boxes, lines):
    """Points of distance; what may not happen costs a thousand."""
    label.put(*place[:2])
    box, end = label.box, label.nearest()
    outside = (
        max(bounds[0] - box[0], 0)
        + max(bounds[1] - box[1], 0)
        + max(box[2] - bounds[2], 0)
        + max(box[3] - bounds[3], 0)
    )
    cost = place[2] + 1000 * outside
    for other in others:
        if overlap(box, other.box):
            cost += 1000
        if crosses((label.x, label.y), end, other.box):
            cost += 300
        if crosses((other.x, other.y), other.nearest(), box) or cut(
            (label.x, label.y), end, (other.x, other.y), other.nearest()
        ):
            cost += 300
    for taken in boxes:
        if overlap(box, taken):
            cost += 400
        elif crosses((label.x, label.y), end, taken):
            cost += 60
    return cost + 12 * sum(crosses(*line, box) for line in lines)


def overlap(a, b):
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def crosses(start, end, box):
    """Whether a segment meets a box (clipping after Liang and Barsky)."""
    low, high = 0.0, 1.0
    for axis in (0, 1):
        step = end[axis] - start[axis]
        for side, sign in ((box[axis], -1), (box[axis + 2], 1)):
            room, speed = sign * (side - start[axis]), sign * step
            if speed == 0:
                if room < 0:
                    return False
            elif speed < 0:
                low = max(low, room / speed)
            else:
                high = min(high, room / speed)
    return low < high


def cut(a, b, c, d):
    """Whether two segments cross."""

    def side(p, q, r):
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0


def draw(area, label, color, leader_color, shorten_by=CLEAR, **style):
    """The text, and a thin line to the marker if it is not beside it. The axes count in points."""
    left, bottom, right, top = label.box
    end = label.nearest()
    length = math.hypot(end[0] - label.x, end[1] - label.y)
    if length > 13:
        start = (
            label.x + (end[0] - label.x) * shorten_by / length,
            label.y + (end[1] - label.y) * shorten_by / length,
        )
        area.plot(
            [start[0], end[0]],
            [start[1], end[1]],
            color=leader_color,
            lw=0.6,
            zorder=2,
            solid_capstyle="butt",
        )
    # Anchored on the side of the marker, so that another font does not open a gap.
    align = "left" if label.x < left else "right" if label.x > right else "center"
    x = {"left": left, "right": right, "center": (left + right) / 2}[align]
    area.text(
        x,
        (bottom + top) / 2,
        label.words,
        size=label.size,
        weight=label.weight,
        color=color,
        ha=align,
        va="center_baseline",
        zorder=6,
        **style
    )
