"""bench: every method runs, is right, and reports in the agreed form."""
import csv
import os

import numpy as np

from cli_case import CliCase


class Bench(CliCase):
    def test_every_method_on_a_scene(self):
        report = self.report("bench", "--scene", "clusters", "-n", "3k", "--repeat", "2", "--sample", "3000",
                             "--csv", self.path("x.csv"))
        self.assertEqual((report["schema"], report["command"]), (1, "bench"))
        for key in ("version", "hash", "compiler", "cpu", "threads", "memory_bytes"):
            self.assertTrue(report["machine"][key], key)
        self.assertEqual([r["method"] for r in report["results"]], ["ours-index", "ours-mask", "ours-count"])
        self.assertEqual(report["estimators"], [])
        for result in report["results"]:
            self.assertEqual((result["scene"], result["points"]), ("clusters", 3000))
            self.assertEqual(set(result["seconds"]) - {"first"}, {"grid", "search", "total", "min", "max"})
            self.assertLessEqual(result["seconds"]["min"], result["seconds"]["total"])
            self.assertLessEqual(result["seconds"]["total"], result["seconds"]["max"])
            self.assertEqual(set(result["memory"]), {"peak_rss_bytes", "structure_bytes", "list_bytes"})
            self.assertGreater(result["memory"]["structure_bytes"], 0)
            accuracy = result["accuracy"]
            self.assertEqual(accuracy["checked_queries"], 3000)
            self.assertEqual((accuracy["missing"], accuracy["extra"], accuracy["max_ulp"]), (0, 0, 0))
            self.assertEqual(accuracy["asymmetric"], None if result["method"] == "ours-count" else 0)
        self.assertEqual(len({result["pairs"] for result in report["results"]}), 1)
        with open(self.path("x.csv")) as file:
            rows = list(csv.DictReader(file))
        self.assertEqual([row["method"] for row in rows], ["ours-index", "ours-mask", "ours-count"])
        self.assertEqual([int(row["pairs"]) for row in rows], [r["pairs"] for r in report["results"]])

    def test_file_and_options(self):
        path = self.scene("block", 1000)
        pairs = self.report("search", path)["result"]["pairs"]
        for args in ([], ["--cell-size", "0.5"], ["-T", "1"], ["--shuffle", "5"]):
            report = self.report("bench", path, "--method", "ours-mask", "--repeat", "1", "--sample", "50", *args)
            self.assertEqual([r["pairs"] for r in report["results"]], [pairs])
            self.assertEqual(report["results"][0]["scene"], "block.vdb")
        self.assertRegex(self.succeeds("bench", path, "--repeat", "1").out, r"(?m)^ours-count +[0-9]+ ")

    def test_points_are_handed_out(self):
        raw, shuffled = self.path("a.f32"), self.path("b.f32")
        base = ["bench", "--scene", "block", "-n", "1000", "--repeat", "1", "--method", "ours-index", "--points-out"]
        pairs = [self.report(*base, raw)["results"][0]["pairs"],
                 self.report(*base, shuffled, "--shuffle", "1")["results"][0]["pairs"]]
        self.assertEqual(pairs[0], pairs[1])
        first, second = (np.fromfile(f, np.float32).reshape(-1, 3) for f in (raw, shuffled))
        self.assertEqual(len(first), 1000)
        self.assertFalse((first == second).all())
        self.assertEqual(sorted(map(tuple, first)), sorted(map(tuple, second)))
        radius = self.report(*base, self.path("c.f32"))["results"][0]["radius"]
        report = self.report("search", self.npy("a.npy", first), "-r", repr(radius))
        self.assertEqual(report["result"]["pairs"], pairs[0])

    def test_bad_flags(self):
        path = self.scene()
        for args in ([], [path, "--scene", "block", "-n", "10"], ["--scene", "block"], [path, "-n", "10"],
                     [path, "--method", "theirs"], [path, "--repeat", "0"], [path, "--sample", "x"],
                     ["--scene", "nonsense", "-n", "10"], [path, "--shuffle", "x"], [path, "-r", "0"],
                     [path, "--json", self.path("a"), "--csv", self.path("a")], [path, "--csv", path, "-f"],
                     [path, "--stability"], [path, "--chart", "x.svg"]):
            self.fails(2, "bench", *args)
        self.fails(3, "bench", self.path("missing.vdb"), says="missing.vdb")
        self.assertTrue(os.path.getsize(path) > 1000)
