"""The tables of the page: rows of cells with units in the head, small bars behind what matters most."""

from charts.report import (
    divide,
    has_lists,
    is_model,
    million_per_second,
    nanoseconds_per_neighbor,
    number,
    per_million,
    plus,
    text,
    typical,
    verdict,
    wrong_per_million,
)
from charts.style import escape, percent, plain, short, size


class Column:
    """A head, what it means (a tooltip), and the text of a row's cell; `bar` gives the length of a bar.

    @param style CSS class: "text", or "text long" for what may take several lines; numbers have none
    """

    def __init__(self, head, cell, meaning="", style="", bar=None):
        self.head, self.cell, self.meaning, self.style, self.bar = head, cell, meaning, style, bar


def table(rows, columns, marked=lambda row: False):
    """HTML of a table; columns in which no row has anything are left out, marked rows are set off."""
    cells = [[column.cell(row) for row in rows] for column in columns]
    shown = [at for at in range(len(columns)) if any(cell not in ("", "–") for cell in cells[at])]
    longest = {at: max([columns[at].bar(row) or 0 for row in rows] + [0]) for at in shown if columns[at].bar}
    head = "".join(
        f'<th scope="col" title="{escape(columns[at].meaning)}"{_class(columns[at])}>{columns[at].head}</th>'
        for at in shown
    )
    body = []
    for place, row in enumerate(rows):
        line = "".join(
            f"<td{_class(columns[at])}{_bar(columns[at], row, longest.get(at))}>{cells[at][place]}</td>"
            for at in shown
        )
        body.append(f'<tr class="marked">{line}</tr>' if marked(row) else f"<tr>{line}</tr>")
    return (
        f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>\n'
        + "\n".join(body)
        + "\n</tbody></table></div>"
    )


def _class(column):
    return f' class="{column.style}"' if column.style else ""


def _bar(column, row, longest):
    value = column.bar(row) if column.bar and longest else None
    if not value:
        return ""
    return f' class="bar" style="background-size:{100 * value / longest:.1f}% 100%"'


def words(key):
    return lambda row: escape(text(row, key))


def value(*path, show=plain):
    return lambda row: show(number(row, *path))


def per(above, below, factor=1, show=plain):
    """above / below of the row, each a path."""
    return lambda row: show(divide(number(row, *above), number(row, *below), factor))


def _by_scene(report, section):
    return [(scene, report.of(section, scene)) for scene in report.scenes(section)]


def _titled(report, section, columns, marked=lambda row: False, order=None):
    """A table per scene under the scene's name."""
    return "\n".join(
        f"<h3>{escape(scene)}</h3>\n" + table(sorted(rows, key=order) if order else rows, columns, marked)
        for scene, rows in _by_scene(report, section)
    )


# ---- plain results ----


def _range(row):
    low, high = number(row, "seconds", "min"), number(row, "seconds", "max")
    return "" if low is None or high is None else f"{plain(low)}…{plain(high)}"


def _verdict(row):
    word = verdict(row)
    shade = {"exact": "v-exact", "wrong": "v-wrong"}.get(word, "v-skipped")
    return f'<span class="chip {shade}">{word}</span>'


def _method(row):
    return escape(text(row, "method")) + (' <span class="chip model">model</span>' if is_model(row) else "")


RESULTS = [
    Column("method", _method, style="text"),
    Column("verdict", _verdict, "from the queries that were checked", style="text"),
    Column(
        "million<br>particles/s",
        lambda row: plain(million_per_second(row)),
        "of the median run",
        bar=million_per_second,
    ),
    Column("seconds", value("seconds", "total"), "median run: structure and search"),
    Column("min…max", _range, "seconds of the fastest and slowest run"),
    Column("ns per<br>particle", per(("seconds", "total"), ("points",), 1e9)),
    Column("ns per<br>neighbor", lambda row: plain(nanoseconds_per_neighbor(row))),
    Column("structure<br>B/particle", per(("memory", "structure_bytes"), ("points",))),
    Column("lists<br>B/neighbor", per(("memory", "list_bytes"), ("pairs",))),
    Column("peak", value("memory", "peak_rss_bytes", show=size), "largest resident memory of the process"),
    Column(
        "missing<br>/ million",
        lambda row: short(per_million(row, "missing")),
        "per million true pairs of the checked queries",
    ),
    Column(
        "extra<br>/ million",
        lambda row: short(per_million(row, "extra")),
        "per million true pairs of the checked queries",
    ),
    Column(
        "asym-<br>metric", value("accuracy", "asymmetric", show=short), "pairs found in one direction only"
    ),
    Column(
        "worst<br>ulp",
        value("accuracy", "max_ulp", show=short),
        "largest distance of a wrong pair from the radius, in ulps",
    ),
    Column("count<br>error", value("accuracy", "count_rmse"), "root mean square, in neighbors"),
    Column("density<br>error", value("accuracy", "density_rmse", show=percent), "root mean square, relative"),
    Column("queries<br>checked", value("accuracy", "checked_queries", show=short)),
]


def results(report):
    """Fastest first; what a model timed comes after what was measured."""
    return _titled(
        report,
        "results",
        RESULTS,
        order=lambda row: (is_model(row), -(million_per_second(row) or 0), text(row, "method")),
    )


def _fastest(rows, kind):
    """The fastest measured method of a kind that stores its lists and has no wrong pair that was found."""
    right = [
        row
        for row in rows
        if text(row, "kind") == kind
        and wrong_per_million(row) == 0
        and not is_model(row)
        and million_per_second(row)
        and has_lists(row)
    ]
    return max(right, key=million_per_second, default={})


def summary(report):
    """One row per scene: what it is, and the fastest exact methods, ours and others, with stored lists."""
    rows = [
        {
            "scene": scene,
            "first": typical(members),
            **{kind: _fastest(members, kind) for kind in ("engine", "device", "peer")},
        }
        for scene, members in _by_scene(report, "results")
    ]

    def best(kind):
        return lambda row: (
            f"{escape(text(row[kind], 'method'))} <b>{plain(million_per_second(row[kind]))}</b> M/s"
            if row[kind]
            else "–"
        )

    def ratio(row):
        quotient = divide(million_per_second(row["engine"]), million_per_second(row["peer"]))
        return "–" if quotient is None else plain(quotient) + " ×"

    return table(
        rows,
        [
            Column("scene", words("scene"), style="text"),
            Column("particles", value("first", "points")),
            Column("neighbors<br>each", per(("first", "pairs"), ("first", "points"))),
            Column("radius", value("first", "radius", show=short)),
            Column("this engine, CPU", best("engine"), style="text"),
            Column("this engine, devices", best("device"), style="text"),
            Column("another library", best("peer"), style="text"),
            Column("engine on the CPU<br>/ library", ratio),
        ],
    )


# ---- the other sections ----


def estimators(report):
    return _titled(
        report,
        "estimators",
        [
            Column("estimator", words("estimator"), style="text"),
            Column("seconds", value("seconds")),
            Column(
                "of a count",
                per(("seconds",), ("count_seconds",), show=percent),
                "seconds against those of a full count",
            ),
            Column("bias", value("bias", show=percent)),
            Column("rms error", value("rmse", show=percent)),
            Column("50 % of<br>blocks within", value("p50", show=percent)),
            Column("99 % of<br>blocks within", value("p99", show=percent)),
            Column("worst block", value("max", show=percent)),
            Column("blocks that<br>overflow", value("overflow_rate", show=percent)),
            Column("reserved<br>/ used", value("reserved_over_used")),
            Column("reserved", value("reserved_bytes", show=size)),
            Column("used", value("used_bytes", show=size)),
            Column("queries<br>counted", value("counted_queries")),
            Column("blocks", value("blocks")),
        ],
    )


def _device(row):
    return escape(text(row, "device")) + (
        ' <span class="chip model">model</span>' if row.get("model") is True else ""
    )


def budgets(report):
    return _titled(
        report,
        "budgets",
        [
            Column("device", _device, style="text"),
            Column("lists", words("encoding"), style="text"),
            Column("memory", value("share", show=percent), "of what everything at once needs"),
            Column("bytes", value("budget_bytes", show=size)),
            Column("outcome", words("outcome"), style="text"),
            Column(
                "million<br>particles/s",
                lambda row: plain(divide(number(row, "particles_per_second"), 1e6)),
                bar=lambda row: number(row, "particles_per_second"),
            ),
            Column("seconds", value("seconds")),
            Column("blocks", value("blocks")),
            Column("largest block,<br>cells a side", value("largest_block_cells")),
            Column("over-<br>flows", value("overflows")),
            Column("retries", value("retries")),
            Column("splits", value("splits")),
            Column(
                "on the<br>CPU",
                per(("cpu_particles",), ("points",), show=percent),
                "particles that the CPU searched",
            ),
            Column("message", words("message"), style="text long"),
        ],
    )


def resolution(report):
    """By lists and cell size, with what auto takes set off and every total against the best of its lists."""
    parts = []
    for scene, rows in _by_scene(report, "resolution"):
        for encoding in dict.fromkeys(text(row, "encoding") for row in rows):
            members = [row for row in rows if text(row, "encoding") == encoding]
            members.sort(key=lambda row: number(row, "cell_size") or 0)
            parts.append(f"<h3>{escape(scene)}, {escape(encoding)}</h3>\n" + _resolution(members))
    return "\n".join(parts)


def _resolution(rows):
    totals = [number(row, "seconds", "total") for row in rows]
    best = min([total for total in totals if total], default=None)

    def against_best(row):
        quotient = divide(number(row, "seconds", "total"), best)
        return "–" if quotient is None else "fastest" if quotient == 1 else f"+{percent(quotient - 1)}"

    return table(
        rows,
        [
            Column("cell edge<br>/ radius", value("cell_size")),
            Column("auto", lambda row: "auto" if row.get("chosen") is True else "", style="text"),
            Column("reach,<br>cells", value("reach")),
            Column("particles<br>per cell", value("particles_per_cell")),
            Column("cells", value("cells", show=short)),
            Column("leaves", value("leaves", show=short)),
            Column("grid, s", value("seconds", "grid")),
            Column("search, s", value("seconds", "search")),
            Column("total, s", value("seconds", "total"), bar=lambda row: number(row, "seconds", "total")),
            Column("against<br>the fastest", against_best),
            Column("structure", value("structure_bytes", show=size)),
            Column("lists", value("list_bytes", show=size)),
            Column("candidate<br>tests", value("candidate_tests", show=short)),
        ],
        marked=lambda row: row.get("chosen") is True,
    )


def _wrong(row):
    wrong = number(row, "wrong_per_million")
    return plain(wrong) + (" (sample)" if wrong is not None and row.get("complete") is False else "")


def scaling(report, vary):
    """All runs in which one thing was varied."""
    rows = [row for row in report["scaling"] if row.get("vary") == vary]
    rows.sort(key=lambda row: (text(row, "scene"), text(row, "method"), number(row, "value") or 0))
    constant = [
        ("points", Column("particles", value("points", show=short))),
        ("threads", Column("threads", value("threads"))),
        ("radius", Column("radius", value("radius", show=short))),
    ]
    return table(
        rows,
        [
            Column("scene", words("scene"), style="text"),
            Column("method", words("method"), style="text"),
            Column(escape(vary), value("value", show=short)),
            *(column for name, column in constant if name != vary),
            Column("pairs", value("pairs", show=short)),
            Column("seconds", value("seconds", "total")),
            Column("min…max", _range),
            Column("ns per<br>particle", per(("seconds", "total"), ("points",), 1e9)),
            Column("ns per<br>neighbor", lambda row: plain(nanoseconds_per_neighbor(row))),
            Column("structure", value("structure_bytes", show=size)),
            Column("wrong<br>/ million", _wrong),
        ],
    )


STEPS = ("grid", "estimate", "tree", "schedule")


def model_share(report):
    """What the model of the scene costs before and beside the search itself."""

    def modeled(row):
        return plus(*(number(row, "seconds", step) for step in STEPS))

    def overhead(row):
        return plus(*(number(row, "bytes", part) for part in ("estimate", "tree", "schedule")))

    return _titled(
        report,
        "model_share",
        [
            Column("lists", words("encoding"), style="text"),
            Column(
                "runs", lambda row: "in core" if row.get("in_core") is True else "in blocks", style="text"
            ),
            Column("blocks", value("blocks")),
            *(Column(f"{step}, s", value("seconds", step)) for step in STEPS + ("search", "total")),
            Column(
                "before the<br>search",
                lambda row: percent(divide(modeled(row), number(row, "seconds", "total"))),
                "grid, estimate, tree and schedule, of the total",
                bar=lambda row: divide(modeled(row), number(row, "seconds", "total")),
            ),
            *(
                Column(f"{part}<br>B/particle", per(("bytes", part), ("points",)))
                for part in ("structure", "estimate", "tree", "schedule", "lists")
            ),
            Column(
                "estimate to schedule<br>of the structure",
                lambda row: percent(divide(overhead(row), number(row, "bytes", "structure"))),
            ),
        ],
    )


def savings(report):
    """What each thing that is left out, when a scene does not need it, saves."""

    def amount(key):
        return lambda row: (size if text(row, "unit") == "bytes" else plain)(number(row, key))

    def saved(row):
        quotient = divide(number(row, "without"), number(row, "with"))
        return None if quotient is None else 1 - quotient

    return _titled(
        report,
        "savings",
        [
            Column("what", words("part"), style="text long"),
            Column("unit", words("unit"), style="text"),
            Column("if kept", amount("with"), "the cost with the part"),
            Column("left out", amount("without"), "the cost without the part"),
            Column("saved", lambda row: percent(saved(row)), bar=lambda row: max(0, saved(row) or 0)),
        ],
    )


def _sets(report, section, part):
    """A table for each part of a study of sets; `part` gives the title of a row's part."""
    titles = dict.fromkeys(part(row) for row in report[section])
    return "\n".join(
        f"<h3>{escape(title)}</h3>\n" + _set_table([row for row in report[section] if part(row) == title])
        for title in titles
    )


def _set_table(rows):
    return table(
        rows,
        [
            Column("method", words("method"), style="text"),
            Column("particles", value("points", show=short)),
            Column("queries<br>timed", value("queries", show=short)),
            Column("pairs", value("pairs", show=short)),
            Column("grid, s", value("seconds", "grid")),
            Column("search, s", value("seconds", "search")),
            Column("total, s", value("seconds", "total"), bar=lambda row: number(row, "seconds", "total")),
            Column("against<br>ours", value("ratio")),
            Column("missing", value("accuracy", "missing", show=short)),
            Column("extra", value("accuracy", "extra", show=short)),
            Column("wrong<br>/ million", value("accuracy", "wrong_per_million")),
            Column("message", words("message"), style="text long"),
        ],
        marked=lambda row: row.get("exact") is True,
    )


def radii(report):
    return _sets(report, "radii", lambda row: ", ".join(text(row, key) for key in ("scene", "radii", "mode")))


def nearest(report):
    return _sets(report, "nearest", lambda row: f"{text(row, 'scene')}, the nearest {plain(number(row, 'nearest'))}")


def measures(report):
    """Time and errors of every measure by every method."""
    titles = dict.fromkeys((text(row, "scene"), text(row, "measure")) for row in report["measures"])
    return "\n".join(
        f"<h3>{escape(scene)}, {escape(measure)}</h3>\n"
        + _measure_table([row for row in report.of("measures", scene) if text(row, "measure") == measure])
        for scene, measure in titles
    )


def _measure_table(rows):
    unit = "°" if any(_unit(row) == "degrees" for row in rows) else ""

    def error(key):
        return lambda row: _with(number(row, "accuracy", key), unit)

    def axis(key):
        return lambda row: _with(number(row, "accuracy", "axis", key), "°")

    return table(
        rows,
        [
            Column("method", words("method"), style="text"),
            Column("particles", value("points", show=short)),
            Column("grid, s", value("seconds", "grid")),
            Column("pass, s", value("seconds", "pass"), bar=lambda row: number(row, "seconds", "pass")),
            Column("against<br>counting", value("ratio"), "the pass over that of counting alone"),
            Column("error,<br>rms", error("rms")),
            Column("99 %", error("p99")),
            Column("largest", error("max")),
            Column("one-sided", value("accuracy", "one_sided", show=short)),
            Column("axis,<br>rms", axis("rms"), "of the longest axis, where the second is at most 0.9 of it"),
            Column("99 %", axis("p99")),
            Column("largest", axis("max")),
            Column("message", words("message"), style="text long"),
        ],
        marked=lambda row: row.get("exact") is True,
    )


def _unit(row):
    return text(row["accuracy"], "unit") if isinstance(row.get("accuracy"), dict) else ""


def _with(amount, unit):
    return plain(amount, 2) + ("" if amount is None else unit)
