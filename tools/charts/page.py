"""One HTML page of everything: no scripts, nothing loaded from elsewhere, light in dark browsers too."""

from charts import budgets, estimators, measures, scaling, speed_error, stability, tables
from charts.report import number, text
from charts.style import escape, plain, size

# How each section is read.
SHORT_HOW = (
    "The fastest measured methods that store every list and of which no wrong pair was found, in million "
    "particles per second (M/s)."
)
SPEED_HOW = (
    "Each mark is a method. Left of the cut: no wrong pair found. Right of it: the further, the more "
    "pairs are missing or extra. Higher is faster. The line is the Pareto front of measured methods that "
    "make lists: no other beats them in both; the grey ones are beaten. Methods without lists do less and "
    "beat nobody; hollow marks are times that a model of a device gave, and beat nobody either."
)
RESULTS_HOW = (
    "All methods of the chart above in figures: the fastest first, those with the time of a model last. "
    "ns: nanoseconds of the median run, structure and search. “Exact in the sample” is all that a check "
    "of some queries can say."
)
ESTIMATORS_HOW = (
    "Before a block runs on a device, its pairs are estimated, for they decide how much memory it needs. "
    "Low and left is good; an error of 10 % means that 99 % of the blocks have at most 10 % more or fewer "
    "pairs than expected."
)
BUDGETS_HOW = (
    "How much speed is left while the memory of a device shrinks, from all that is needed at the left to "
    "1 % of it at the right, and how many blocks had to run again because their result did not fit."
)
RESOLUTION_HOW = (
    "The edge of the cells against time, memory and distance tests: small cells test less and cost more "
    "to keep. The row that is set off is what <code>--cell-size auto</code> takes."
)
SCALING_HOW = (
    "One thing grows, the others stay. A level line is good for times; for threads the broad grey line is "
    "the ideal."
)
SHARE_HOW = (
    "What is spent on a model of the scene (grid, estimate, workload tree, schedule) before a single pair "
    "is searched."
)
SAVINGS_HOW = "What is left out when the scene, or the question, does not need it, and what that saves."
RADII_HOW = (
    "Every particle has a radius of its own: graded 1:100 with the spacing, or one in a hundred four times "
    "as large. The engine, which is exact, beside what one does without such radii. Where fewer queries than "
    "particles were timed, seconds are scaled up to all."
)
NEAREST_HOW = (
    "Of every list only the nearest within the radius. The engine, which is exact, beside full lists, full "
    "lists that are sorted and cut afterwards, and the nearest of a tree, with and without the radius."
)
MEASURES_HOW = (
    "Density, normals and ellipsoids (pca) by the engine, by float32 sums over the exact neighbors, by half of the "
    "neighbors, by the 32 nearest, and by the engine on positions stored in 16 and 8 bits. Low and left is good. "
    "“One-sided” are values that only one of method and truth has: normals that are not 0, ellipsoids."
)
STABILITY_HOW = (
    "Cases in which methods of this kind are known to fail. The best answer is exact, the next best a "
    "refusal; wrong pairs without a word are worse, and a crash takes the host program along. Rest the "
    "pointer on a cell for its message, time and memory; all messages are below the table."
)


class Section:
    """A part of the page: how to read it, the flags of `vdb_nns bench` that make its data, charts, a table."""

    def __init__(self, title, how, flags, charts=(), body=""):
        self.title, self.how, self.flags, self.charts, self.body = title, how, flags, charts, body
        self.name = title.lower().replace(" ", "-")

    def html(self):
        figures = "".join(f"<figure>{chart.svg()}</figure>\n" for chart in self.charts if chart.is_shown)
        return (
            f'<section id="{self.name}">\n<h2>{escape(self.title)}</h2>\n<p class="how">{self.how}</p>\n'
            f"{figures}{self.body}\n</section>"
        )


def build(report):
    """(html, charts): the page and the charts in it, in its order."""
    machine = _machine(report.machines[0] if report.machines else {})
    machine += " · and others" if len(report.machines) > 1 else ""

    def made(make, section):
        return make(report) if report[section] else ""

    sections = [
        Section("In short", SHORT_HOW, "--study methods", body=made(tables.summary, "results")),
        Section("Speed against error", SPEED_HOW, "--study methods", speed_error.charts(report, machine)),
        Section("Results", RESULTS_HOW, "--study methods", body=made(tables.results, "results")),
        Section(
            "Stability",
            STABILITY_HOW,
            "--stability",
            stability.charts(report, machine),
            made(stability.html, "stability"),
        ),
        Section(
            "Estimators",
            ESTIMATORS_HOW,
            "--study estimators",
            estimators.charts(report, machine),
            made(tables.estimators, "estimators"),
        ),
        Section(
            "Memory budget",
            BUDGETS_HOW,
            "--study budgets",
            budgets.charts(report, machine),
            made(tables.budgets, "budgets"),
        ),
        Section(
            "Resolution", RESOLUTION_HOW, "--study resolution", body=made(tables.resolution, "resolution")
        ),
        Section(
            "Scaling",
            SCALING_HOW,
            "--study scaling",
            scaling.charts(report, machine),
            _scaling_tables(report),
        ),
        Section("Model share", SHARE_HOW, "--study model", body=made(tables.model_share, "model_share")),
        Section(
            "No more than a scene needs", SAVINGS_HOW, "--study model", body=made(tables.savings, "savings")
        ),
        Section("Radii of particles", RADII_HOW, "--study radii", body=made(tables.radii, "radii")),
        Section("The nearest", NEAREST_HOW, "--study nearest", body=made(tables.nearest, "nearest")),
        Section(
            "Measures",
            MEASURES_HOW,
            "--study measures",
            measures.charts(report, machine),
            made(tables.measures, "measures"),
        ),
    ]
    return _document(report, sections), [chart for section in sections for chart in section.charts]


def _scaling_tables(report):
    varied = dict.fromkeys(text(row, "vary") for row in report["scaling"])
    return "\n".join(f"<h3>By {escape(vary)}</h3>\n{tables.scaling(report, vary)}" for vary in varied)


def _machine(machine):
    """A machine in one line: what is known of it."""
    facts = [
        ("vdb_nns ", text(machine, "version")),
        ("commit ", text(machine, "hash")),
        ("", text(machine, "compiler")),
        ("", text(machine, "cpu")),
    ]
    facts = [before + what for before, what in facts if what]
    for key, word in (("cores", "cores"), ("threads", "threads")):
        if number(machine, key):
            facts.append(f"{plain(number(machine, key))} {word}")
    if number(machine, "memory_bytes"):
        facts.append(f"{size(number(machine, 'memory_bytes'))} of memory")
    return " · ".join(facts) or "an unnamed machine"


def _document(report, sections):
    filled = [section for section in sections if section.charts or section.body]
    missing = [section for section in sections if section not in filled]
    links = "".join(f'<a href="#{section.name}">{escape(section.title)}</a>' for section in filled)
    body = "\n".join(section.html() for section in filled)
    scenes = list(
        dict.fromkeys(
            scene for section in ("results", "scaling", "estimators") for scene in report.scenes(section)
        )
    )
    about = f"Scenes: {escape(', '.join(scenes))}." if scenes else ""
    alarm = (
        ""
        if report.all_agree
        else (
            '<p class="alarm"><b>Not all methods that promise exact pairs found the same ones</b> '
            "(<code>all_agree</code> is false).</p>\n"
        )
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="only light">
<title>vdb_nns bench</title>
<style>
{CSS}
{stability.css()}
</style>
</head>
<body>
<header>
<h1>vdb_nns bench</h1>
<p class="lead">Speed, accuracy and stability of neighbor search within a fixed radius. {about}</p>
<nav>{links}</nav>
</header>
<main>
{alarm}{body}
{_left_out(missing)}
</main>
<footer>
{_footer(report)}
</footer>
</body>
</html>
"""


def _left_out(missing):
    if not missing:
        return ""
    lines = "".join(
        f"<li>{escape(section.title)}: <code>vdb_nns bench {escape(section.flags)}</code></li>\n"
        for section in missing
    )
    return (
        '<section id="left-out">\n<h2>Not in this page</h2>\n<p class="how">No data; what makes them:</p>\n'
        f"<ul>\n{lines}</ul>\n</section>"
    )


def _footer(report):
    lines = [escape(_machine(machine)) for machine in report.machines] or [
        "The reports do not name their machine."
    ]
    if len(report.machines) > 1:
        lines.insert(0, "Several machines or builds; compare only what ran on one of them:")
    if report.dates:
        lines.append(escape(", ".join(report.dates)))
    return "\n".join(f"<p>{line}</p>" for line in lines)


CSS = """:root { color-scheme: only light; }
* { box-sizing: border-box; }
html { background: #ffffff; color: #1b1f24; }
body { margin: 0; font: 15px/1.5 system-ui, 'Segoe UI', 'Helvetica Neue', Arial, sans-serif; }
header, main, footer { max-width: 1400px; margin: 0 auto; padding: 0 32px; }
header { padding-top: 36px; }
h1 { font-size: 30px; margin: 0; letter-spacing: -0.01em; }
h2 { font-size: 21px; margin: 0 0 4px; }
h3 { font-size: 15px; margin: 22px 0 6px; }
.lead { color: #57606a; margin: 4px 0 14px; font-size: 16px; }
.how { color: #57606a; margin: 0 0 14px; max-width: 62em; }
nav { display: flex; flex-wrap: wrap; gap: 6px 18px; padding: 10px 0;
  border-top: 1px solid #d8dee4; border-bottom: 1px solid #d8dee4; }
nav a { color: #0a5a91; text-decoration: none; }
nav a:hover { text-decoration: underline; }
section { margin: 40px 0 56px; }
figure { margin: 0 0 18px -16px; }
figure svg { display: block; width: 100%; height: auto; max-width: 1352px; }
figure svg [id$="-machine"] { display: none; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums;
  font: 13px/1.3 'Segoe UI', 'Helvetica Neue', Arial, 'Liberation Sans', 'DejaVu Sans Condensed', sans-serif; }
th, td { padding: 4px 8px; text-align: right; white-space: nowrap; border-bottom: 1px solid #e6eaee; }
th { color: #57606a; font-weight: 600; vertical-align: bottom; }
thead th { border-bottom: 1px solid #8b949e; }
th.text, td.text, table.text th, table.text td { text-align: left; }
td.long { white-space: normal; min-width: 220px; max-width: 420px; }
tr.marked td { background-color: #fff4d6; font-weight: 600; }
td.bar { background-image: linear-gradient(#cfe0ee, #cfe0ee); background-repeat: no-repeat; min-width: 96px; }
.chip { display: inline-block; padding: 0 6px; border-radius: 3px; border: 1px solid #00000022;
  font-size: 12px; }
.chip.model { border: 1px dashed #57606a; color: #57606a; }
.legend { font-size: 13px; color: #57606a; }
.legend span { white-space: nowrap; }
.alarm { border-left: 5px solid #a8201a; background: #fbeceb; padding: 10px 14px; margin: 24px 0 0; }
table.matrix { font-size: 12px; }
table.matrix thead th:first-child { text-align: left; }
table.matrix td { text-align: center; border: 2px solid #ffffff; padding: 3px 5px; min-width: 66px; }
table.matrix th[scope=row] { text-align: left; font-weight: 500; color: #1b1f24; white-space: normal;
  min-width: 250px; max-width: 330px; }
table.matrix th small { display: block; color: #6e7781; font-weight: 400; font-size: 11px; }
table.matrix .group th { text-align: left; padding-top: 14px; color: #1b1f24; font-weight: 700;
  border-bottom: 1px solid #8b949e; }
table.matrix .turned { text-align: center; }
table.matrix .turned span { writing-mode: vertical-rl; transform: rotate(180deg); }
table.matrix tfoot td, table.matrix tfoot th[scope=row] { font-weight: 700; padding-top: 8px; border: 0; }
details { margin: 14px 0; }
summary { cursor: pointer; color: #0a5a91; }
code { font-family: ui-monospace, Consolas, 'DejaVu Sans Mono', monospace; font-size: 0.93em; }
footer { border-top: 1px solid #d8dee4; color: #57606a; font-size: 13px; padding: 14px 32px 40px; }
footer p { margin: 0 0 2px; }
@media print { nav { display: none; } figure, tr { break-inside: avoid; } }"""
