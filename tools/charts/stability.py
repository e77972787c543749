"""Chart D: which method survives which case, as an HTML table and as a picture. The word in a cell says what
its color says."""

from charts.report import number, text
from charts.style import (
    FAINT,
    FOOTER,
    PAPER,
    SOFT,
    WIDTH,
    Chart,
    escape,
    figure,
    plain,
    short,
    shorten,
    size,
    text_width,
)

# verdict: (paper, letters); from light to dark by how bad it is, so that it reads in grey too.
COLORS = {
    "exact": ("#d5efe3", "#0b5c43"),
    "skipped": ("#ffffff", "#6e7781"),
    "refused": ("#cfdbe6", "#2f4a63"),
    "wrong": ("#f5b14c", "#3d2600"),
    "memory": ("#8a5a34", "#ffffff"),
    "hang": ("#7a4b94", "#ffffff"),
    "crash": ("#a8201a", "#ffffff"),
}
MEANINGS = {
    "exact": "every pair or value right",
    "wrong": "so many wrong pairs or values, silently",
    "refused": "said that it cannot",
    "crash": "the process died",
    "hang": "stopped after the time limit",
    "memory": "ran out of memory",
    "skipped": "not run",
}
ROW, NAMES, CELL = (
    15,
    232,
    (46, 62),
)  # points: height of a row, width of case names, least and most width of a cell


class Matrix:
    """Cases in their groups against methods."""

    def __init__(self, rows):
        of_case = {}
        for row in rows:
            of_case.setdefault((text(row, "group"), text(row, "case")), []).append(text(row, "method"))
        fullest = max(of_case.values(), key=len)  # its order is the order of all
        self.methods = list(dict.fromkeys(fullest + [text(row, "method") for row in rows]))
        self.groups, self.cells, self.what = {}, {}, {}
        for row in rows:
            case = (text(row, "group"), text(row, "case"))
            self.groups.setdefault(case[0], [])
            if case not in self.groups[case[0]]:
                self.groups[case[0]].append(case)
            self.cells[case, text(row, "method")] = row
            self.what[case] = self.what.get(case) or text(row, "what")

    def lines(self):
        """("group", name) and ("case", case) from top to bottom."""
        for group, cases in self.groups.items():
            yield "group", group
            for case in cases:
                yield "case", case

    def score(self, method):
        """Cases exact, and cases run."""
        run = [text(row, "verdict") for (_, name), row in self.cells.items() if name == method]
        return run.count("exact"), len(run) - run.count("skipped")

    def verdicts(self):
        """Those that occur, in the order of COLORS, unknown ones last."""
        found = {text(row, "verdict") for row in self.cells.values()}
        return [verdict for verdict in COLORS if verdict in found] + sorted(found - set(COLORS))


def words(row):
    """What a cell says."""
    verdict = text(row, "verdict") or "–"
    wrong = sum(number(row, key) or 0 for key in ("missing", "extra", "wrong_values"))
    wrong = wrong or number(row, "asymmetric") or 0
    return f"{verdict} {short(wrong, 2)}" if verdict == "wrong" and wrong else verdict


def colors(row):
    return COLORS.get(text(row, "verdict"), (PAPER, SOFT))


def charts(report, machine):
    """The matrix as a picture; of many methods several, so that every cell keeps its word."""
    rows = report["stability"]
    if not rows:
        return []
    methods = Matrix(rows).methods
    most = int((WIDTH - 90 - NAMES) / CELL[0])
    parts = -(-len(methods) // most)
    per_part = -(-len(methods) // parts)
    made = []
    for part in range(parts):
        members = methods[part * per_part : (part + 1) * per_part]
        matrix = Matrix([row for row in rows if text(row, "method") in members])
        name = "stability" + (f"-{part + 1}" if parts > 1 else "")
        made.append(Chart(name, "Stability", _draw(matrix, machine), is_shown=False))
    return made


def _draw(matrix, machine):
    head = min(max([text_width(method, 7.5) for method in matrix.methods]), 130) * 0.87 + 14
    lines = list(matrix.lines())
    overhang = 0.5 * min(text_width(matrix.methods[-1], 7.5), 130)  # of the last name
    width_of_cell = min(CELL[1], (WIDTH - 24 - NAMES - overhang) / len(matrix.methods))
    height = 70 + head + (len(lines) + 2) * ROW + FOOTER + 14
    made = figure(
        height,
        "Stability: what methods do where methods fail",
        "one row per case, one column per method",
        machine,
    )
    area = made.add_axes([0, 0, 1, 1], facecolor="none")
    area.set_axis_off()
    area.set_xlim(0, WIDTH)
    area.set_ylim(height, 0)
    _draw_legend(area, matrix)
    top = 66 + head
    left = 12 + NAMES
    for at, method in enumerate(matrix.methods):
        area.text(
            left + (at + 0.35) * width_of_cell,
            top - 4,
            shorten(method, 130, 7.5),
            size=7.5,
            rotation=60,
            ha="left",
            va="bottom",
            rotation_mode="anchor",
        )
    for at, (kind, line) in enumerate(lines):
        _draw_line(area, matrix, kind, line, top + at * ROW, width_of_cell)
    foot = top + (len(lines) + 0.3) * ROW
    area.text(12, foot + ROW / 2, "exact of cases run", size=8, weight="bold", va="center_baseline")
    for at, method in enumerate(matrix.methods):
        right, run = matrix.score(method)
        area.text(
            left + (at + 0.5) * width_of_cell,
            foot + ROW / 2,
            f"{right}/{run}",
            size=7.5,
            weight="bold",
            ha="center",
            va="center_baseline",
        )
    return made


def _draw_legend(area, matrix):
    """A cell of every verdict, and what it means."""
    x = 12
    for verdict in matrix.verdicts():
        paper, letters = COLORS.get(verdict, (PAPER, SOFT))
        wide = text_width(verdict, 7) + 8
        edge = PAPER if verdict in COLORS and verdict != "skipped" else FAINT
        area.fill([x, x + wide, x + wide, x], [44, 44, 58, 58], facecolor=paper, edgecolor=edge, lw=0.6)
        area.text(x + wide / 2, 51, verdict, size=7, color=letters, ha="center", va="center_baseline")
        meaning = MEANINGS.get(verdict, "")
        area.text(x + wide + 4, 51, meaning, size=7, color=SOFT, va="center_baseline")
        x += wide + text_width(meaning, 7) + 14


def _draw_line(area, matrix, kind, line, y, width):
    if kind == "group":
        area.text(
            12,
            y + ROW * 0.6,
            shorten(line or "cases", NAMES, 8, "bold"),
            size=8,
            weight="bold",
            va="center_baseline",
        )
        area.plot([12, 12 + NAMES + width * len(matrix.methods)], [y + ROW - 1] * 2, color=FAINT, lw=0.6)
        return
    area.text(18, y + ROW / 2, shorten(line[1], NAMES - 12, 7.5), size=7.5, color=SOFT, va="center_baseline")
    for at, method in enumerate(matrix.methods):
        row = matrix.cells.get((line, method))
        x = 12 + NAMES + at * width
        paper, letters = colors(row) if row else (PAPER, FAINT)
        area.fill(
            [x, x + width, x + width, x],
            [y, y, y + ROW, y + ROW],
            facecolor=paper,
            edgecolor=PAPER if row else "none",
            lw=1.2,
        )
        said = shorten(words(row), width - 3, 6.8) if row else "·"
        area.text(
            x + width / 2, y + ROW / 2, said, size=6.8, color=letters, ha="center", va="center_baseline"
        )


# ---- HTML ----


def html(report):
    """The matrix as a table, and below it every message."""
    matrix = Matrix(report["stability"])
    head = "".join(
        f'<th scope="col" class="turned"><span>{escape(method)}</span></th>' for method in matrix.methods
    )
    parts = [
        '<div class="wide"><table class="matrix">',
        f'<thead><tr><th scope="col">case</th>{head}</tr></thead>',
        "<tbody>",
    ]
    for kind, line in matrix.lines():
        if kind == "group":
            span = len(matrix.methods) + 1
            parts.append(f'<tr class="group"><th colspan="{span}">{escape(line or "cases")}</th></tr>')
            continue
        cells = "".join(_cell(matrix.cells.get((line, method))) for method in matrix.methods)
        what = f"<small>{escape(matrix.what[line])}</small>" if matrix.what[line] else ""
        parts.append(f'<tr><th scope="row">{escape(line[1])}{what}</th>{cells}</tr>')
    scores = "".join("<td>{}/{}</td>".format(*matrix.score(method)) for method in matrix.methods)
    parts.append(
        f'</tbody><tfoot><tr><th scope="row">exact of cases run</th>{scores}</tr></tfoot></table></div>'
    )
    return _legend(matrix) + "\n".join(parts) + _messages(matrix)


def _legend(matrix):
    chips = "".join(
        f'<span><span class="chip v-{escape(verdict)}">{escape(verdict)}</span> '
        f'{escape(MEANINGS.get(verdict, ""))}</span> &ensp; '
        for verdict in matrix.verdicts()
    )
    return f'<p class="legend">{chips}</p>'


def _cell(row):
    if row is None:
        return '<td class="none">·</td>'
    facts = [
        text(row, "method"),
        words(row),
        text(row, "message"),
        f"missing {plain(number(row, 'missing'))}",
        f"extra {plain(number(row, 'extra'))}",
        f"asymmetric {plain(number(row, 'asymmetric'))}",
        f"wrong values {plain(number(row, 'wrong_values'))}",
        f"{plain(number(row, 'seconds'))} s",
        f"peak {size(number(row, 'peak_rss_bytes'))}",
    ]
    title = escape(" · ".join(fact for fact in facts if fact))
    return f'<td class="v-{escape(text(row, "verdict"))}" title="{title}">{escape(words(row))}</td>'


def _messages(matrix):
    said = [
        (case[1], method, words(row), text(row, "message"))
        for (case, method), row in matrix.cells.items()
        if text(row, "message").strip()
    ]
    if not said:
        return ""
    rows = "".join("<tr>" + "".join(f"<td>{escape(value)}</td>" for value in line) + "</tr>" for line in said)
    return (
        f'<details><summary>What they said, {len(said)} messages</summary><table class="text"><thead><tr>'
        "<th>case</th><th>method</th><th>verdict</th><th>message</th></tr></thead>"
        f"<tbody>{rows}</tbody></table></details>"
    )


def css():
    return "\n".join(
        f".v-{verdict} {{ background: {paper}; color: {letters}; }}"
        for verdict, (paper, letters) in COLORS.items()
    )
