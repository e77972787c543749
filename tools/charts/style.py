"""How everything looks: colors that color-blind readers tell apart (Okabe and Ito), numbers as people write
them, and the one way from a figure to SVG and PNG. Every chart also has to read in grey, so color is never
the only sign."""

import io
import math
import re
import warnings

import matplotlib

matplotlib.use("Agg")
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path

INK, SOFT, FAINT, LEADER, RULE, PAPER, BAND = (
    "#1b1f24",
    "#57606a",
    "#8b949e",
    "#b8c0c8",
    "#d8dee4",
    "#ffffff",
    "#f3f6f9",
)
BLUE, GREEN, ORANGE, VERMILION, PURPLE, SKY, BLACK = (
    "#0072b2",
    "#009e73",
    "#e69f00",
    "#d55e00",
    "#a8578a",
    "#56b4e9",
    "#333333",
)
LINES = [
    (BLUE, "o", "-"),
    (VERMILION, "s", "--"),
    (GREEN, "^", "-."),
    (PURPLE, "D", ":"),
    (BLACK, "v", "-"),
    (ORANGE, "P", "--"),
    (SKY, "X", "-."),
]

_ON_PAPER = {
    ORANGE: "#8f6200",
    SKY: "#1f6f9f",
    GREEN: "#007a59",
}  # for letters, which are thinner than markers

# Points a figure is wide; the page shows it at 4/3 pixels a point.
WIDTH = 880
FOOTER = 18  # points for the line that names the machine

_SETTINGS = {
    "svg.fonttype": "none",
    "svg.hashsalt": "vdb_nns",
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "text.color": INK,
    "axes.labelcolor": SOFT,
    "axes.edgecolor": FAINT,
    "axes.linewidth": 0.8,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "text.usetex": False,
    "text.parse_math": False,
    "axes.unicode_minus": False,
}
# A letter that DejaVu Sans lacks is a box in a PNG and right in a browser: no warning.
warnings.filterwarnings("ignore", message="Glyph .* missing from")
matplotlib.rcParams.update({key: value for key, value in _SETTINGS.items() if key in matplotlib.rcParams})

# A chart is laid out with DejaVu Sans, which Matplotlib brings along. Browsers take the first of these
# that they have; all are narrower.
_FONTS = "'Segoe UI', 'Helvetica Neue', Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif"


class Chart:
    """A drawn figure with the name of its files.

    @param is_shown whether the page shows it, or has the same as a table
    """

    def __init__(self, name, title, figure, is_shown=True):
        self.name, self.title, self.figure, self.is_shown = name, title, figure, is_shown

    def svg(self):
        """A standalone SVG, the same bytes every time; identifiers start with the name, for pages with several."""
        buffer = io.StringIO()
        self.figure.savefig(
            buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None}
        )
        body = buffer.getvalue()
        body = body[body.index("<svg") :]
        body = re.sub(r'\bid="', f'id="{self.name}-', body)
        body = re.sub(r"url\(#", f"url(#{self.name}-", body)
        body = re.sub(r'href="#', f'href="#{self.name}-', body)
        body = body.replace("'DejaVu Sans'", _FONTS)
        return body.replace("<svg ", f'<svg role="img" aria-label="{escape(self.title)}" ', 1)

    def png(self):
        buffer = io.BytesIO()
        self.figure.savefig(buffer, format="png", dpi=144, metadata={"Software": None})
        return buffer.getvalue()


def escape(value):
    """Text for HTML and XML, in and out of attributes."""
    return str(value).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace('"', "&quot;")


def file_names(values):
    """Texts as parts of names of files, no two the same."""
    names = {}
    for value in values:
        name = re.sub(r"[^A-Za-z0-9]+", "-", value).strip("-").lower()[:60] or "scene"
        same = sum(other == name or other.startswith(name + "--") for other in names.values())
        names[value] = f"{name}--{same + 1}" if same else name
    return names


def figure(height, title, subtitle, machine, width=WIDTH):
    """An empty figure of so many points, with title, lines below it and the machine at the foot."""
    made = Figure(figsize=(width / 72, height / 72), facecolor=PAPER)
    made.text(
        12 / width,
        1 - 18 / height,
        shorten(title, width - 24, 12, "bold"),
        size=12,
        weight="bold",
        va="center",
    )
    for at, line in enumerate(subtitle.split("\n")):
        made.text(
            12 / width,
            1 - (36 + 13 * at) / height,
            shorten(line, width - 24, 8.5),
            size=8.5,
            color=SOFT,
            va="center",
        )
    made.text(
        12 / width,
        9 / height,
        shorten(machine, width - 24, 6.5),
        size=6.5,
        color=FAINT,
        va="center",
        gid="machine",
    )
    return made


def axes(made, left, bottom, width, height):
    """Axes at a rectangle in points from the figure's lower left corner; only the spines with a scale."""
    full = made.get_figwidth() * 72, made.get_figheight() * 72
    area = made.add_axes(
        [left / full[0], bottom / full[1], width / full[0], height / full[1]], facecolor="none"
    )
    area.spines[["top", "right"]].set_visible(False)
    area.tick_params(length=3, width=0.8, labelsize=8)
    area.set_axisbelow(True)
    return area


def letters(color):
    """The color, dark enough for text."""
    return _ON_PAPER.get(color, color)


def text_width(words, size=8.5, weight="normal"):
    """Width in points as laid out."""
    return text_to_path.get_text_width_height_descent(words, FontProperties(size=size, weight=weight), False)[
        0
    ]


def shorten(words, width, size=8.5, weight="normal"):
    """The text, its end cut where it is wider than so many points."""
    if text_width(words, size, weight) <= width:
        return words
    while words and text_width(words + "…", size, weight) > width:
        words = words[:-1]
    return words.rstrip() + "…"


# ---- numbers ----


def plain(value, digits=3):
    """So many significant digits or more, an exponent only below 1e-4 and from 1e15 on; "–" for None."""
    if value is None:
        return "–"
    if value == 0:
        return "0"
    size = abs(value)
    if size >= 1e15 or size < 1e-4:
        return f"{value:.{digits - 1}e}".replace("e+0", "e").replace("e-0", "e-").replace("e+", "e")
    if isinstance(value, int) or size >= 10 ** (digits - 1):
        return f"{value:,.0f}"
    decimals = max(0, digits - 1 - math.floor(math.log10(size)))
    return f"{value:.{decimals}f}"


def short(value, digits=3):
    """12.3 k, 4.00 M: a count that has to be short."""
    if value is None:
        return "–"
    for unit, name in ((1e12, " T"), (1e9, " G"), (1e6, " M"), (1e3, " k")):
        if abs(value) >= unit:
            return _trim(plain(value / unit, digits)) + name
    return _trim(plain(value, digits))


def _trim(digits):
    return digits.rstrip("0").rstrip(".") if "." in digits and "e" not in digits else digits


def size(value):
    """Bytes in decimal units."""
    return "–" if value is None else short(value) + ("B" if abs(value) >= 1000 else " B")


def percent(value, digits=2):
    return "–" if value is None else _trim(plain(100 * value, digits)) + " %"
