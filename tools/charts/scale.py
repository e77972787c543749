"""Scales from values to points along an axis: a logarithm with a place of its own for zero, and a linear one.

Zero is what most methods here reach and a logarithm cannot show. The zero place is cut off from the rest, so
nobody reads a distance into it.
"""

import math

from charts.style import FAINT, plain, short


class BrokenLog:
    """Values <= 0 lie in the middle of the zero place [0, zero], the others over [zero, length]; in points.

    @param room points at the far end that no value reaches, for labels
    """

    def __init__(self, values, length, zero=0.0, pad=0.06, room=0.0):
        positive = [value for value in values if value is not None and value > 0]
        low, high = (math.log10(min(positive)), math.log10(max(positive))) if positive else (-1.0, 2.0)
        if high - low < 1:
            low, high = (low + high - 1) / 2, (low + high + 1) / 2
        margin = pad * (high - low)
        self.low, self.last = low - margin, high + margin
        self.high = self.low + (high + margin - self.low) * (length - zero) / (length - zero - room)
        self.length, self.zero = length, zero

    def at(self, value):
        if value <= 0:
            return self.zero / 2
        return self.zero + (self.length - self.zero) * (math.log10(value) - self.low) / (self.high - self.low)

    def ticks(self, most=8):
        """[(place, label)] of round values where values are, not more than about so many."""
        decades = self.high - self.low
        steps = (1, 2, 5) if decades < 2.2 else (1,)
        every = max(1, math.ceil(decades / most))
        values = [
            step * 10.0**power
            for power in range(math.floor(self.low), math.ceil(self.high) + 1)
            for step in steps
            if power % every == 0
        ]
        return [
            (self.at(value), tick(value)) for value in values if self.low <= math.log10(value) <= self.last
        ]

    def on_axis(self, area, axis, zero_label="0", ticks=None):
        """Gives an axis ("x" or "y") these ticks, and cuts it between the zero place and the rest."""
        zero = [(self.zero / 2, zero_label)] if self.zero else []
        _set_ticks(area, axis, self.length, zero + (self.ticks() if ticks is None else ticks))
        for shift in (-2, 2) if self.zero else ():
            along, across = [self.zero + shift - 1.5, self.zero + shift + 1.5], [-4, 4]
            area.plot(
                *((along, across) if axis == "x" else (across, along)),
                color=FAINT,
                lw=0.9,
                clip_on=False,
                zorder=9
            )


class Linear:
    """From `low` at 0, or where it is None a little under the least value, to over the greatest."""

    def __init__(self, values, length, low=None, room=0.0):
        known = [value for value in values if value is not None] or [0.0, 1.0]
        high = max(known)
        self.low = min(known) if low is None else low
        if high <= self.low:
            high = self.low + (abs(self.low) or 1)
        margin = 0.06 * (high - self.low)
        self.low -= margin if low is None else 0
        self.last = high + margin
        self.high = self.low + (high + margin - self.low) * length / (length - room)
        self.length = length

    def at(self, value):
        return self.length * (value - self.low) / (self.high - self.low)

    def ticks(self, most=6):
        rough = (self.high - self.low) / most
        power = 10.0 ** math.floor(math.log10(rough))
        step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= rough * 0.999)
        first = math.ceil(self.low / step - 1e-9)
        values = [at * step for at in range(first, math.floor(self.last / step + 1e-9) + 1)]
        return [(self.at(value), tick(value)) for value in values]

    def on_axis(self, area, axis, ticks=None):
        _set_ticks(area, axis, self.length, self.ticks() if ticks is None else ticks)


def _set_ticks(area, axis, length, ticks):
    set_limits, of_axis = (area.set_xlim, area.xaxis) if axis == "x" else (area.set_ylim, area.yaxis)
    set_limits(0, length)
    of_axis.set_ticks([place for place, _ in ticks])
    of_axis.set_ticklabels([label for _, label in ticks])


def tick(value):
    """A round value as on an axis: 0.01, 5, 20 k, 1 M."""
    if abs(value) < 1e4:
        return plain(
            round(value) if abs(value) >= 1 and value == round(value) else round(value, 12),
            1 if abs(value) < 1 else 2,
        )
    return short(value)
