"""Chart C: throughput and retries while the memory of the device shrinks."""

from charts.lines import Panels, draw_lines, grid, note, room_for, style_of
from charts.report import number, text
from charts.scale import BrokenLog, Linear
from charts.style import SOFT, Chart, letters, plain

SPEED, RETRIES, BAR = 150, 62, 7  # points


def charts(report, machine):
    """One chart with a panel per scene and device."""
    groups = {}
    for row in report["budgets"]:
        if (number(row, "share") or 0) > 0:
            groups.setdefault((text(row, "scene"), text(row, "device"), row.get("model") is True), []).append(
                row
            )
    if not groups:
        return []
    words = (
        "Less memory: throughput and retries",
        "memory the device may use, in percent of what everything at once would need; "
        "it shrinks to the right · "
        "x: refused, for it does not fit\n"
        "a retry is a block that runs again because its result did not fit what was estimated · "
        "MODEL: the times are computed from a model of the device, hollow marks",
    )
    titles = [
        " · ".join(filter(None, (scene, device, "MODEL" if model else ""))) for scene, device, model in groups
    ]
    panels = Panels(titles, [SPEED, RETRIES], words, machine)
    styles = style_of(text(row, "encoding") for row in report["budgets"])
    for areas, ((_, _, model), rows) in zip(panels.areas, groups.items()):
        across = _Shrinking([number(row, "share") for row in rows], panels.width, room_for(styles))
        _draw_speed(areas[0], rows, across, styles, model)
        _draw_retries(areas[1], rows, across, styles)
    return [Chart("budgets", words[0], panels.figure)]


class _Shrinking:
    """Shares on a logarithm from the largest at the left to the smallest at the right."""

    def __init__(self, shares, length, room):
        self.shares = sorted(set(shares))
        self.scale = BrokenLog([1 / share for share in shares], length - room, pad=0.07)
        self.length = length

    def at(self, share):
        return self.scale.at(1 / share)

    def on_axis(self, area, is_labeled):
        """Marks the shares that were run, as far as there is room."""
        ticks, last = [], -100
        for share in reversed(self.shares):
            if self.at(share) - last > 27:
                last = self.at(share)
                ticks.append((last, f"{plain(round(100 * share, 6), 1)} %"))
        area.set_xlim(0, self.length)
        area.set_xticks([place for place, _ in ticks])
        area.set_xticklabels([label if is_labeled else "" for _, label in ticks])
        area.spines["bottom"].set_bounds(0, self.scale.length)


def _by_encoding(rows):
    groups = {}
    for row in rows:
        groups.setdefault(text(row, "encoding"), []).append(row)
    return groups


def _draw_speed(area, rows, across, styles, model):
    lines = {
        encoding: [
            (number(row, "share"), number(row, "particles_per_second") / 1e6)
            for row in members
            if number(row, "particles_per_second") is not None and row.get("outcome") != "refused"
        ]
        for encoding, members in _by_encoding(rows).items()
    }
    up = Linear([y for points in lines.values() for _, y in points], SPEED, low=0)
    across.on_axis(area, is_labeled=False)
    up.on_axis(area, "y")
    grid(area, up)
    area.set_ylabel("million particles / s")
    draw_lines(area, lines, across, up, styles, hollow=model)
    refused = [
        (number(row, "share"), text(row, "encoding")) for row in rows if row.get("outcome") == "refused"
    ]
    for share, encoding in refused:
        x, y = across.at(share), 7 + 10 * list(styles).index(encoding)
        area.plot(x, y, marker="x", ms=6, mew=1.8, color=styles[encoding][0], ls="none", zorder=5)
        area.text(x + 6, y, encoding, size=7, color=letters(styles[encoding][0]), va="center_baseline")
    if not any(lines.values()) and not refused:
        note(area, across, up, "no times")


def _draw_retries(area, rows, across, styles):
    retries = {
        (encoding, number(row, "share")): number(row, "retries")
        for encoding, members in _by_encoding(rows).items()
        for row in members
    }
    up = Linear(list(retries.values()) + [1], RETRIES, low=0)
    across.on_axis(area, is_labeled=True)
    up.on_axis(area, "y", ticks=[(up.at(value), plain(value)) for value in sorted({0, int(up.high)})])
    area.set_ylabel("retries")
    area.set_xlabel("memory of the device, % of the need, logarithmic")
    names = list(styles)
    for (encoding, share), value in retries.items():
        if not value:
            continue
        x = across.at(share) + BAR * (names.index(encoding) - (len(names) - 1) / 2)
        color, hatch = styles[encoding][0], ("", "//////", "....")[names.index(encoding) % 3]
        area.bar(
            x,
            up.at(value),
            width=BAR,
            facecolor="white" if hatch else color,
            edgecolor=color,
            hatch=hatch,
            lw=0.8,
        )
        area.text(x, up.at(value) + 1.5, plain(value), size=6.5, color=SOFT, ha="center", va="bottom")
    if not any(retries.values()):
        note(area, across, up, "no retries")
