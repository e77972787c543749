"""The JSON of `vdb_nns bench`: reading, checking and merging it, and what charts and tables derive from it.

Every number that is missing, null, not finite or not a number reads as None, so nobody has to check twice.
"""

import json

# What makes two records the same, per section: the last one wins when files are merged.
KEYS = {
    "results": ("scene", "method"),
    "estimators": ("scene", "estimator"),
    "budgets": ("scene", "device", "model", "encoding", "share"),
    "resolution": ("scene", "encoding", "cell_size", "chosen"),
    "scaling": ("scene", "method", "vary", "value"),
    "model_share": ("scene", "encoding", "in_core"),
    "savings": ("scene", "part", "unit"),
    "radii": ("scene", "radii", "mode", "method"),
    "nearest": ("scene", "nearest", "method"),
    "measures": ("scene", "measure", "method"),
    "stability": ("case", "group", "method"),
}


class BadReport(Exception):
    """A file that is not a report of `vdb_nns bench`; the message names it and says what is wrong."""


class Report:
    """Sections by name, each a list of dicts; the machines that ran them; whether the methods agreed."""

    def __init__(self):
        self.sections = {name: [] for name in KEYS}
        self.machines = []
        self.dates = []
        self.all_agree = True
        self.notes = []  # for stderr

    def __getitem__(self, section):
        return self.sections[section]

    def scenes(self, section):
        """Scenes of a section in the order in which they came."""
        return list(dict.fromkeys(text(row, "scene") for row in self.sections[section]))

    def of(self, section, scene):
        return [row for row in self.sections[section] if text(row, "scene") == scene]


def load(paths):
    """One report of several files. @raises BadReport"""
    report = Report()
    for path in paths:
        _merge(report, _read(path), path)
    return report


def _read(path):
    try:
        with open(path, encoding="utf-8") as file:
            document = json.load(file)
    except OSError as error:
        raise BadReport(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise BadReport(f"{path}: is not JSON: {error}") from error
    if not isinstance(document, dict) or document.get("command") != "bench":
        raise BadReport(f'{path}: is JSON but no report of `vdb_nns bench` (it has no "command": "bench")')
    if document.get("schema") != 1:
        raise BadReport(f"{path}: has schema {document.get('schema')!r}, this program reads schema 1")
    for section in KEYS:
        rows = document.get(section)
        if rows is not None and not (isinstance(rows, list) and all(isinstance(row, dict) for row in rows)):
            raise BadReport(f'{path}: "{section}" is not a list of objects')
    if not isinstance(document.get("machine") or {}, dict):
        raise BadReport(f'{path}: "machine" is not an object')
    return document


def _merge(report, document, path):
    machine = document.get("machine") or {}
    if machine and machine not in report.machines:
        report.machines.append(machine)
    date = document.get("date") or machine.get("date")
    if isinstance(date, str) and date not in report.dates:
        report.dates.append(date)
    report.all_agree = report.all_agree and document.get("all_agree") is not False
    for section, keys in KEYS.items():
        known = {_identity(row, keys): at for at, row in enumerate(report.sections[section])}
        replaced = []
        for row in document.get(section) or []:
            identity = _identity(row, keys)
            if identity in known:
                report.sections[section][known[identity]] = row
                replaced.append(", ".join(str(row.get(key)) for key in keys))
            else:
                known[identity] = len(report.sections[section])
                report.sections[section].append(row)
        if replaced:
            count = f"{len(replaced)} of {section} are" if len(replaced) > 1 else f"one of {section} is"
            report.notes.append(f"{path}: {count} there twice, the last ones count (first: {replaced[0]})")


def _identity(row, keys):
    return tuple(json.dumps(row.get(key), sort_keys=True) for key in keys)


# ---- one record ----


def number(row, *path):
    """The number at a path of keys, else None."""
    for key in path:
        row = row.get(key) if isinstance(row, dict) else None
    return None if isinstance(row, bool) or not isinstance(row, (int, float)) else _drawable(row)


def _drawable(value):
    """The value if a logarithmic axis can take it: None from 1e100 on and for NaN, 0 below 1e-100."""
    if not -1e100 < value < 1e100:
        return None
    return value if abs(value) > 1e-100 else 0


def text(row, key):
    """The text at a key, control characters made visible as spaces; "" when there is none."""
    value = row.get(key)
    if value is None:
        return ""
    return "".join(c if c.isprintable() else " " for c in str(value)) or " "


def divide(above, below, factor=1):
    """factor * above / below, None where that is no number."""
    if above is None or below is None or below <= 0:
        return None
    return _drawable(factor * above / below)


def plus(*values):
    """Sum of those that are known, None when none is."""
    known = [value for value in values if value is not None]
    return sum(known) if known else None


# ---- derived numbers of a result ----


def is_model(result):
    """Whether its seconds are computed from a model of a device instead of measured."""
    device = result.get("device")
    return isinstance(device, dict) and device.get("virtual") is True


def has_lists(result):
    """Whether it found lists; counts alone have no density."""
    accuracy = result.get("accuracy")
    return not (isinstance(accuracy, dict) and "density_rmse" in accuracy and accuracy["density_rmse"] is None)


def true_pairs(result):
    """True pairs of the queries that were checked; None when unknown."""
    pairs, points = number(result, "pairs"), number(result, "points")
    missing, extra = number(result, "accuracy", "missing"), number(result, "accuracy", "extra")
    checked = number(result, "accuracy", "checked_queries")
    if None in (pairs, points, checked) or not points:
        return None
    found = pairs * min(1, checked / points)
    return found + (missing or 0) - (extra or 0)


def per_million(result, which):
    """Wrong pairs ("missing" or "extra") per million true pairs of what was checked; else None."""
    told = number(result, "accuracy", which + "_per_million")
    if told is not None:
        return told
    count = number(result, "accuracy", which)
    if count is None or not number(result, "accuracy", "checked_queries"):
        return None
    return 0 if count == 0 else divide(count, true_pairs(result), 1e6)


def wrong_per_million(result):
    missing, extra = per_million(result, "missing"), per_million(result, "extra")
    return None if missing is None or extra is None else missing + extra


def is_sampled(result):
    """Whether only some of the queries were checked."""
    accuracy = result.get("accuracy")
    if isinstance(accuracy, dict) and isinstance(accuracy.get("complete"), bool):
        return not accuracy["complete"]
    checked, points = number(result, "accuracy", "checked_queries"), number(result, "points")
    return checked is not None and points is not None and checked < points


def million_per_second(result, seconds="total"):
    """Particles per microsecond; None without a time."""
    return divide(number(result, "points"), number(result, "seconds", seconds), 1e-6)


def nanoseconds_per_neighbor(row):
    return divide(number(row, "seconds", "total"), number(row, "pairs"), 1e9)


def typical(results):
    """The result that stands for its scene: one with all pairs if there is one."""
    known = [row for row in results if number(row, "points")] or results
    return next((row for row in known if wrong_per_million(row) == 0), known[0])


def verdict(result):
    """exact | exact in the sample | wrong | unchecked, from what was checked."""
    wrong = wrong_per_million(result)
    if wrong is None:
        return "unchecked"
    if wrong > 0 or (number(result, "accuracy", "asymmetric") or 0) > 0:
        return "wrong"
    return "exact in the sample" if is_sampled(result) else "exact"


def pareto(points):
    """Which of (cost, gain) no other one beats: less cost and as much gain, or more gain and no more cost."""

    def beats(other, one):
        return other[0] <= one[0] and other[1] >= one[1] and other != one

    return [not any(beats(other, one) for other in points) for one in points]
