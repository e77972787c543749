"""tools/chart.py: the page is whole and the same every time, says what it lacks, and refuses what is no report.

usage: test_chart.py TOOLS/chart.py
"""
import copy
import html.parser
import importlib.util
import itertools
import json
import os
import random
import subprocess
import sys
import tempfile
import unittest
import xml.etree.ElementTree

CHART = None  # set below
VOID = {"meta", "br", "path", "use", "rect"}


def result(scene, method, kind="engine", seconds=0.1, missing=0, extra=0, virtual=None, **more):
    """A result of 1000 particles and 30 000 pairs, every query checked."""
    return {
        "scene": scene, "method": method, "kind": kind, "threads": 2, "points": 1000, "pairs": 30000, "radius": 0.1, "runs": 3,
        "seconds": {"grid": 0, "search": seconds, "total": seconds, "min": seconds * 0.9, "max": seconds * 1.2, "first": seconds},
        "memory": {"peak_rss_bytes": 10**8, "structure_bytes": 29000, "list_bytes": 120000},
        "accuracy": {"complete": True, "checked_queries": 1000, "missing": missing, "extra": extra,
                     "missing_per_million": missing / 0.03, "extra_per_million": extra / 0.03, "asymmetric": 0, "max_ulp": 1.5,
                     "count_rmse": 0.1, "count_max": 2, "density_rmse": 0.01, "density_max": 0.05},
        "device": None if virtual is None else {"virtual": virtual}, **more}


def full_report():
    """Something of every section."""
    methods = [("ours-index", "engine", 0.1, 0), ("ours-mask", "engine", 0.08, 0), ("blocks-mask", "device", 0.01, 0),
               ("world-float", "part", 0.07, 3), ("sampled10", "approximate", 0.02, 20000), ("openvdb", "peer", 1.0, 1),
               ("nanoflann-double", "peer", 2.0, 0)]
    seconds = {"grid": 0.1, "estimate": 0.01, "tree": 0.001, "schedule": 0.001, "search": 0.3, "total": 0.412}
    return {
        "schema": 1, "version": "0.1.0", "command": "bench", "all_agree": True,
        "machine": {"version": "0.1.0", "hash": "abc1234", "compiler": "GNU 12.2.0", "cpu": "A CPU", "threads": 2, "cores": 4,
                    "memory_bytes": 8 * 10**9},
        "results": [result(scene, name, kind, time, wrong, virtual=True if kind == "device" else None)
                    for scene in ("block", "spray") for name, kind, time, wrong in methods],
        "estimators": [{"scene": "block", "estimator": name, "seconds": time, "count_seconds": 1, "blocks": 8, "p99": error}
                       for name, time, error in (("paper", 0.01, 0.1), ("counted", 1, 0), ("fixed", 0, 2), ("sampled:1", 0.1, 0.02))],
        "budgets": [{"scene": "block", "device": "sim", "model": True, "encoding": encoding, "share": share, "budget_bytes": 1000,
                     "particles_per_second": share * 1e6 if share > 0.02 else None, "retries": 3, "points": 1000,
                     "outcome": "done" if share > 0.02 else "refused", "message": "" if share > 0.02 else "needs 7 MB"}
                    for encoding in ("index", "mask") for share in (1, 0.5, 0.1, 0.01)],
        "resolution": [{"scene": "block", "encoding": "index", "cell_size": size, "reach": 1, "particles_per_cell": 4, "cells": 100,
                        "leaves": 2, "seconds": {"grid": 1, "search": 2, "total": 3 + size}, "structure_bytes": 1, "list_bytes": 1,
                        "candidate_tests": 10**9, "chosen": size == 1} for size in (0.5, 1, 1.5)],
        "scaling": [{"scene": "block", "method": method, "vary": vary, "value": value, "points": 1000, "threads": 1, "radius": 1,
                     "pairs": 30000, "seconds": {"total": value, "min": value, "max": value}, "structure_bytes": 1,
                     "wrong_per_million": 0, "complete": True}
                    for vary in ("points", "threads", "radius", "clustering") for method in ("ours-index", "openvdb")
                    for value in (1, 2, 4)],
        "model_share": [{"scene": "block", "encoding": "index", "in_core": True, "blocks": 1, "seconds": seconds, "points": 1000,
                         "bytes": {"structure": 1000, "tree": 10, "schedule": 1, "lists": 9000}}],
        "savings": [{"scene": "block", "part": "no lists", "unit": "bytes", "with": 1000, "without": 250}],
        "radii": [{"scene": "block", "radii": "mixed 1:4", "mode": mode, "method": method, "exact": method == "ours", "points": 1000,
                   "queries": 1000, "pairs": 30000, "seconds": {"grid": 0.1, "search": 0.2, "total": 0.3}, "ratio": 1, "message": "",
                   "accuracy": {"missing": wrong, "extra": 0, "wrong_per_million": 33.3 * wrong}}
                  for mode in ("gather", "symmetric") for method, wrong in (("ours", 0), ("nanoflann-k", 7))],
        "nearest": [{"scene": "block", "radii": "one", "mode": None, "nearest": 8, "method": "ours", "exact": True, "points": 1000,
                     "queries": 1000, "pairs": 8000, "seconds": {"grid": 0.1, "search": 0.2, "total": 0.3}, "ratio": 1,
                     "accuracy": {"missing": 0, "extra": 0, "wrong_per_million": 0}, "message": ""}],
        "measures": [{"scene": "block", "measure": measure, "method": method, "exact": method == "ours", "points": 1000, "runs": 3,
                      "seconds": {"grid": 0.1, "pass": time, "total": 0.1 + time, "min": time, "max": time, "counting": 0.1},
                      "ratio": 10 * time, "message": "",
                      "accuracy": {"complete": True, "checked_queries": 1000, "compared": 1000, "rms": error, "p99": 2 * error,
                                   "max": 3 * error, "one_sided": 0, "wrong": None,
                                   "unit": "degrees" if measure == "normal" else "relative",
                                   "axis": {"compared": 9, "rms": error, "p99": error, "max": 7 * error} if measure == "pca" else None}}
                     for measure in ("density", "normal", "pca")
                     for method, time, error in (("ours", 0.3, 0), ("float32", 0.4, 1e-7), ("half", 0.35, 0.2))],
        "stability": [
            {"case": "NaN", "group": "numbers", "what": "One coordinate is no number.", "method": "ours-index", "verdict": "exact",
             "missing": 0, "extra": 0, "asymmetric": 0, "seconds": 1, "peak_rss_bytes": 10**7, "message": ""},
            {"case": "NaN", "group": "numbers", "what": "", "method": "openvdb", "verdict": "wrong", "missing": 5880000, "extra": 0,
             "asymmetric": None, "seconds": 1, "peak_rss_bytes": 10**7, "message": ""},
            {"case": "radius 0", "group": "radius", "what": "", "method": "openvdb", "verdict": "crash", "missing": 0, "extra": 0,
             "asymmetric": None, "seconds": 1, "peak_rss_bytes": 10**7, "message": "signal 11 <b>"},
            {"case": "line", "group": "measures", "what": "", "method": "ours-index", "verdict": "wrong", "missing": 0, "extra": 0,
             "wrong_values": 321, "asymmetric": None, "seconds": 1, "peak_rss_bytes": 10**7, "message": "a normal"}]}


def run(*args, **variables):
    """The exit status and stderr of chart.py; it prints nothing on stdout."""
    done = subprocess.run([sys.executable, "-B", CHART, *args], stdout=subprocess.PIPE, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL,
                          universal_newlines=True, timeout=300, env={**os.environ, **variables})
    assert done.stdout == "", done.stdout
    return done.returncode, done.stderr


class Page(html.parser.HTMLParser):
    """Checks that tags close in order, and keeps identifiers, links, attributes that load something, and the text."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.links, self.loads, self.text = [], [], [], [], ""
        self.titles = []
        self.feed(text)
        assert not self.open, self.open

    def handle_starttag(self, tag, attributes):
        if tag not in VOID:
            self.open.append(tag)
        self.handle_startendtag(tag, attributes)

    def handle_startendtag(self, tag, attributes):
        found = dict(attributes)
        self.ids += [found["id"]] if "id" in found else []
        self.links += [found[key] for key in ("href", "xlink:href") if key in found]
        self.loads += [found[key] for key in ("src", "data", "srcset") if key in found]
        self.loads += [tag] if tag in ("script", "link", "iframe", "object") else []
        self.titles += [found["title"]] if "title" in found else []

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag, tag

    def handle_data(self, data):
        self.text += data


class ChartCase(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="vdb_nns_chart_")
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def path(self, *names):
        return os.path.join(self.folder, *names)

    def bytes_of(self, *names):
        with open(self.path(*names), "rb") as file:
            return file.read()

    def report(self, name, content):
        with open(self.path(name), "w") as file:
            file.write(content if isinstance(content, str) else json.dumps(content))
        return self.path(name)

    def page(self, *contents):
        """The page of these reports, which has to be made without a word."""
        files = [self.report(f"{at}.json", content) for at, content in enumerate(contents)]
        self.assertEqual(run(self.path("out.html"), *files), (0, ""))
        return Page(self.bytes_of("out.html").decode())

    def fails(self, code, words, *args, **variables):
        """The exit status, one line that has these words, and no file more than before."""
        before = sorted(os.listdir(self.folder))
        got, said = run(*args, **variables)
        self.assertEqual(got, code, said)
        self.assertEqual(said.count("\n"), 1, said)
        self.assertTrue(said.startswith("chart.py: "), said)
        for word in words:
            self.assertIn(word, said)
        self.assertEqual(sorted(os.listdir(self.folder)), before)


class Pages(ChartCase):
    def test_a_page_of_everything(self):
        page = self.page(full_report())
        for name in ("in-short", "speed-against-error", "results", "stability", "estimators", "memory-budget", "resolution", "scaling",
                     "model-share", "no-more-than-a-scene-needs", "radii-of-particles", "the-nearest", "measures"):
            self.assertIn(name, page.ids)
        self.assertNotIn("left-out", page.ids)
        self.assertEqual(len(page.ids), len(set(page.ids)))
        self.assertEqual(page.loads, [])
        self.assertEqual([link for link in page.links if not (link.startswith("#") and link[1:] in page.ids)], [])
        self.assertNotIn("url(http", self.bytes_of("out.html").decode())
        for words in ("abc1234", "GNU 12.2.0", "A CPU", "4 cores", "8 GB", "vdb_nns 0.1.0", "blocks-mask (model)", "wrong 5.9 M", "wrong 321",
                      "signal 11 <b>", "Pareto front", "MODEL", "auto", "75 %", "sampled10", "every query", "nanoflann-k", "block, mixed 1:4, symmetric", "block, the nearest 8",
                      "block, pca", "0.20°", "block: measures, error against time", "direction of the longest axis"):
            self.assertIn(words, page.text)
        self.assertTrue(any("signal 11 <b>" in title and "peak 10 MB" in title for title in page.titles))

    def test_images(self):
        names = ["speed-error-block", "speed-error-spray", "stability", "estimators", "budgets", "scaling-points", "scaling-threads",
                 "scaling-radius", "scaling-clustering", "measures-block"]
        self.assertEqual(run(self.path("x.html"), self.report("x.json", full_report()), "--images", self.path("deep", "images")), (0, ""))
        self.assertEqual(sorted(os.listdir(self.path("deep", "images"))), sorted(f"{n}.{e}" for n in names for e in ("png", "svg")))
        for name in names:
            self.assertEqual(xml.etree.ElementTree.fromstring(self.bytes_of("deep", "images", name + ".svg")).tag[-4:], "}svg")
            self.assertTrue(self.bytes_of("deep", "images", name + ".png").startswith(b"\x89PNG\r\n"))

    def test_the_same_bytes(self):
        file = self.report("x.json", full_report())
        for name in ("a", "b"):
            self.assertEqual(run(self.path(name + ".html"), file, "--images", self.path(name)), (0, ""))
        self.assertEqual(self.bytes_of("a.html"), self.bytes_of("b.html"))
        for name in os.listdir(self.path("a")):
            self.assertEqual(self.bytes_of("a", name), self.bytes_of("b", name), name)

    def test_what_is_left_out_is_said(self):
        page = self.page({"schema": 1, "command": "bench"})
        self.assertEqual(page.ids, ["left-out"])
        for flag in ("--study methods", "--stability", "--study estimators", "--study budgets", "--study resolution", "--study scaling",
                     "--study model", "--study radii", "--study nearest", "--study measures"):
            self.assertIn("vdb_nns bench " + flag, page.text)
        page = self.page({**full_report(), "stability": [], "savings": None})
        self.assertNotIn("stability", page.ids)
        self.assertIn("--stability", page.text)
        self.assertNotIn("--study scaling", page.text)

    def test_disagreement_and_dates(self):
        page = self.page({**full_report(), "all_agree": False, "date": "2024-02-30"})
        self.assertIn("all_agree is false", page.text)
        self.assertIn("2024-02-30", page.text)

    def test_one_method(self):
        page = self.page({"schema": 1, "command": "bench", "results": [result("block", "ours-index")]})
        self.assertIn("some wrong pairs: no method here", page.text)
        self.assertIn("do not name their machine", page.text)


class Merging(ChartCase):
    def test_several_scenes_and_machines(self):
        one, two = full_report(), full_report()
        one["results"] = [row for row in one["results"] if row["scene"] == "block"]
        two = {**two, "machine": {**two["machine"], "cpu": "Another CPU"}, "results": [result("far", "ours-index")]}
        for section in ("estimators", "budgets", "resolution", "scaling", "model_share", "savings", "radii", "nearest",
                        "measures", "stability"):
            two[section] = []
        page = self.page(one, two)
        for words in ("block: speed against error", "far: speed against error", "A CPU", "Another CPU", "Several machines"):
            self.assertIn(words, page.text)

    def test_the_last_of_two_wins(self):
        files = [self.report(f"{at}.json", {"schema": 1, "command": "bench", "results": [result("block", "ours-index", seconds=time)]})
                 for at, time in enumerate((0.5, 0.25))]
        code, said = run(self.path("out.html"), *files)
        self.assertEqual((code, said.count("\n")), (0, 1))
        for word in (files[1], "block", "ours-index", "twice", "last"):
            self.assertIn(word, said)
        text = Page(self.bytes_of("out.html").decode()).text
        self.assertIn("0.250", text)
        self.assertNotIn("0.500", text)


class OddData(ChartCase):
    def test_names(self):
        name = "a/b <i>$\\alpha$ & 'q' \"ü\" {} % 漢"
        content = full_report()
        for section in ("results", "estimators", "budgets", "resolution", "scaling", "model_share", "savings", "measures"):
            for row in content[section]:
                row["scene"] = row["scene"].replace("block", name)
                row["method"] = "m <" + row.get("method", "")
        for at, row in enumerate(content["stability"]):
            row.update(case=f"{name} {at}", what=name, message=name)
        page = self.page(content)
        self.assertIn(name, page.text)
        self.assertIn("m <ours-index", page.text)

    def test_scenes_whose_files_have_the_same_name(self):
        names = ["a b", "a-b", "A/B", "..."]
        content = {"schema": 1, "command": "bench", "results": [result(name, "ours-index") for name in names]}
        self.assertEqual(run(self.path("x.html"), self.report("x.json", content), "--images", self.path("images")), (0, ""))
        self.assertEqual(len(os.listdir(self.path("images"))), 2 * len(names))

    def test_every_value_null_zero_huge_or_of_another_kind(self):
        for odd in (None, 0, -1, 1e300, 10**400, 1e-300, "x", {}, float("nan")):
            content = full_report()
            for section in [key for key, value in content.items() if isinstance(value, list)]:
                content[section] = [spoiled for row in content[section][:2] for spoiled in spoil(row, odd)]
            with self.subTest(odd=str(odd)[:9]):
                self.report("x.json", content)
                code, said = run(self.path("out.html"), self.path("x.json"))
                self.assertEqual(code, 0, said)
                self.assertNotIn("Traceback", said)
                self.assertNotIn("Warning", said)
                self.assertNotIn("nan", Page(self.bytes_of("out.html").decode()).text.split())

    def test_unknown_keys_and_rows_without_any(self):
        content = {key: [{}, {"new": {"deep": 1}}] if isinstance(value, list) else value for key, value in full_report().items()}
        code, said = run(self.path("out.html"), self.report("x.json", {**content, "link": 5}))
        self.assertEqual(code, 0, said)


def spoil(row, odd):
    """The row as it is, with half of its numbers odd, and with all of them."""
    def changed(value, keys):
        return {key: changed(inner, keys) if isinstance(inner, dict)
                else odd if next(keys) and isinstance(inner, (int, float)) and key not in ("scene", "method") else inner
                for key, inner in value.items()}
    return [row, changed(copy.deepcopy({**row, "scene": "half"}), itertools.cycle((True, False))),
            changed(copy.deepcopy({**row, "scene": "all"}), itertools.repeat(True))]


class Errors(ChartCase):
    def test_files_that_are_no_report(self):
        bad = {"empty": "", "text": "hello", "cut": '{"schema": 1, "command": "ben', "list": [1], "other": {"a": 1},
               "search": {"schema": 1, "command": "search"}, "schema": {"schema": 2, "command": "bench"},
               "rows": {"schema": 1, "command": "bench", "results": {}}, "row": {"schema": 1, "command": "bench", "budgets": [1]},
               "machine": {"schema": 1, "command": "bench", "machine": "x"}, "deep": "[" * 100000}
        good = self.report("good.json", full_report())
        for name, content in bad.items():
            with self.subTest(name):
                self.fails(2, [self.report(name + ".json", content)], self.path("out.html"), good, self.path(name + ".json"))
        with open(self.path("binary.json"), "wb") as file:
            file.write(b"\xff\xfe\x00{")
        self.fails(2, ["binary.json"], self.path("out.html"), self.path("binary.json"))
        self.fails(2, ["none.json", "No such file"], self.path("out.html"), self.path("none.json"))
        self.fails(2, [self.folder], self.path("out.html"), self.folder)

    def test_a_failure_leaves_the_old_page(self):
        self.report("out.html", "old")
        self.fails(2, ["bad.json"], self.path("out.html"), self.report("bad.json", "no"))
        self.assertEqual(self.bytes_of("out.html"), b"old")

    def test_flags(self):
        for args in ([], [self.path("out.html")], ["--what"]):
            self.assertEqual(run(*args)[0], 2)

    def test_what_cannot_be_written(self):
        file = self.report("x.json", full_report())
        os.mkdir(self.path("folder.html"))
        self.fails(6, ["folder.html"], self.path("folder.html"), file)
        self.fails(6, ["nowhere"], self.path("nowhere", "out.html"), file)
        self.fails(6, ["x.json"], self.path("out.html"), file, "--images", self.path("x.json", "images"))

    def test_without_matplotlib(self):
        os.mkdir(self.path("stub"))
        with open(self.path("stub", "matplotlib.py"), "w") as file:
            file.write("raise ImportError('not here')\n")
        file = self.report("x.json", full_report())
        self.assertEqual(run(self.path("out.html"), file, PYTHONPATH=self.path("stub"), PYTHONDONTWRITEBYTECODE="1"),
                         (3, "chart.py: matplotlib is missing; install python3-matplotlib\n"))
        self.assertFalse(os.path.exists(self.path("out.html")))


class Parts(unittest.TestCase):
    """Functions that a picture hides."""

    def test_pareto(self):
        from charts.report import pareto
        self.assertEqual(pareto([(0, 5), (0, 7), (1, 7), (1, 9), (2, 8), (0, 7)]), [False, True, False, True, False, True])
        self.assertEqual(pareto([]), [])

    def test_rates_of_reports_without_them(self):
        from charts.report import verdict, wrong_per_million
        row = result("block", "x", missing=2, extra=1)
        for key in ("complete", "missing_per_million", "extra_per_million"):
            del row["accuracy"][key]
        self.assertAlmostEqual(wrong_per_million(row), 3e6 / 30001)
        self.assertEqual(verdict(row), "wrong")
        row["accuracy"].update(missing=0, extra=0)
        self.assertEqual((wrong_per_million(row), verdict(row)), (0, "exact"))
        row["accuracy"]["checked_queries"] = 10
        self.assertEqual(verdict(row), "exact in the sample")
        row["accuracy"]["checked_queries"] = 0
        self.assertEqual(verdict(row), "unchecked")

    def test_a_model_beats_nobody(self):
        from charts import speed_error
        points = [speed_error.Point(result("s", "ours", seconds=1)), speed_error.Point(result("s", "model", seconds=0.1, virtual=True))]
        self.assertEqual([point.words() for point in points], ["ours", "model (model)"])
        speed_error.mark_front(points)
        self.assertEqual([point.front for point in points], [True, False])

    def test_numbers(self):
        from charts.style import percent, plain, short, size
        self.assertEqual([plain(v) for v in (None, 0, 1234567, 0.01234, 12.345, 1e20, 1.5e-7)],
                         ["–", "0", "1,234,567", "0.0123", "12.3", "1.00e20", "1.50e-7"])
        self.assertEqual([short(v) for v in (None, 0, 999, 1234, 5.88e6, 3e13)], ["–", "0", "999", "1.23 k", "5.88 M", "30 T"])
        self.assertEqual([size(v) for v in (None, 12, 8.33e9)], ["–", "12 B", "8.33 GB"])
        self.assertEqual([percent(v) for v in (None, 0, 0.5, 0.0123)], ["–", "0 %", "50 %", "1.2 %"])

    def test_labels_in_a_column(self):
        from charts.labels import spread
        places = spread([50, 50, 50, 10, 90, 89], 0, 100, gap=10)
        self.assertTrue(all(b - a >= 10 - 1e-9 for a, b in zip(sorted(places), sorted(places)[1:])), places)
        self.assertTrue(min(places) >= 0 and max(places) <= 100, places)
        self.assertEqual(spread([5, 80], 0, 100, gap=10), [5, 80])
        self.assertEqual(spread([], 0, 100), [])

    def test_labels_in_a_crowd(self):
        from charts.labels import Label, overlap, place_around
        numbers = random.Random(3)
        made = [Label(f"method-{at}", numbers.uniform(150, 300), numbers.uniform(80, 200)) for at in range(20)]
        place_around(made, (0, 0, 500, 300))
        for a, b in itertools.combinations(made, 2):
            self.assertFalse(overlap(a.box, b.box), (a.words, b.words))
        for label in made:
            self.assertTrue(0 <= label.box[0] and label.box[2] <= 500 and 0 <= label.box[1] and label.box[3] <= 300, label.words)

    def test_zero_has_its_place(self):
        from charts.scale import BrokenLog
        scale = BrokenLog([0, 0.1, 1000], 100, zero=20)
        self.assertEqual(scale.at(0), 10)
        self.assertTrue(20 < scale.at(0.1) < scale.at(1) < scale.at(1000) < 100)
        self.assertEqual([label for _, label in scale.ticks()], ["0.1", "1", "10", "100", "1,000"])


if __name__ == "__main__":
    CHART = os.path.abspath(sys.argv.pop(1))
    if importlib.util.find_spec("matplotlib") is None:
        print("skipped: no matplotlib")
        sys.exit(77)
    sys.path.insert(0, os.path.dirname(CHART))
    unittest.main(verbosity=2)
