"""bench: every method runs, is right, and reports in the agreed form."""
import csv
import os
import tempfile

import numpy as np

import cli_case
from cli_case import CliCase

CHART = ("bench", "--scene", "block", "-n", "500", "--study", "methods", "--method", "ours-index", "--repeat", "1", "--chart")


class Bench(CliCase):
    def test_every_method_on_a_scene(self):
        report = self.report("bench", "--scene", "clusters", "-n", "3k", "--repeat", "2", "--sample", "3000",
                             "--csv", self.path("x.csv"))
        self.assertEqual((report["schema"], report["command"]), (1, "bench"))
        for key in ("version", "hash", "compiler", "cpu", "threads", "memory_bytes"):
            self.assertTrue(report["machine"][key], key)
        names = [r["method"] for r in report["results"]]
        self.assertEqual(names[:4], ["ours-index", "ours-mask", "ours-count", "ours-visit"])
        for name in ("certified", "filter-only", "world-float", "world-double", "codec16", "codec8", "sampled50", "sampled10",
                     "nearest32", "nearest16", "openvdb", "brute-force"):
            self.assertIn(name, names)
        self.check_nanoflann(names)
        for study in ("estimators", "budgets", "resolution", "scaling", "model_share", "savings", "files", "radii", "nearest",
                      "measures", "stability"):
            self.assertEqual(report[study], [])
        for result in report["results"]:
            self.assertEqual((result["scene"], result["points"]), ("clusters", 3000))
            self.assertEqual(set(result["seconds"]) - {"first"}, {"grid", "search", "total", "min", "max"})
            self.assertLessEqual(result["seconds"]["min"], result["seconds"]["total"])
            self.assertLessEqual(result["seconds"]["total"], result["seconds"]["max"])
            self.assertEqual(set(result["memory"]), {"peak_rss_bytes", "added_bytes", "structure_bytes", "list_bytes"})
            self.assertEqual(result["memory"]["structure_bytes"] > 0, result["method"] != "brute-force")
            accuracy = result["accuracy"]
            self.assertEqual(accuracy["checked_queries"], 3000)
            self.assertTrue(accuracy["complete"])
            self.check_accuracy(result)
        by_kind = {kind: [r for r in report["results"] if r["kind"] == kind] for kind in
                   ("engine", "part", "approximate", "peer")}
        self.assertEqual(len({result["pairs"] for result in by_kind["engine"]}), 1)
        self.assertEqual(sum(map(len, by_kind.values())), len(names))
        with open(self.path("x.csv")) as file:
            rows = list(csv.DictReader(file))
        self.assertEqual([row["method"] for row in rows], names)
        self.assertEqual([int(row["pairs"]) for row in rows], [r["pairs"] for r in report["results"]])

    def check_nanoflann(self, names):
        """A program that was built without it says so, and does without."""
        done = cli_case.run("bench", "--scene", "block", "-n", "100", "--method", "nanoflann-float", "--repeat", "1")
        for name in ("nanoflann-float", "nanoflann-double"):
            self.assertEqual(name in names, done.code == 0, done.err)
        if done.code != 0:
            self.assertNotEqual(os.environ.get("VDB_NNS_REQUIRE_PEERS"), "1", done.err)
            self.assertEqual(done.code, 2)
            self.assertIn("install libnanoflann-dev and build again", done.err)

    def check_accuracy(self, result):
        accuracy, name = result["accuracy"], result["method"]
        pairs = accuracy["true_pairs"]
        self.assertEqual(result["pairs"], pairs - accuracy["missing"] + accuracy["extra"] + accuracy["duplicates"], name)
        self.assertAlmostEqual(accuracy["missing_per_million"], 1e6 * accuracy["missing"] / pairs, delta=1e-6)
        has_rows = name not in ("ours-count", "ours-visit")
        self.assertEqual(accuracy["asymmetric"] is not None, has_rows, name)
        if result["kind"] == "engine" or name in ("certified", "brute-force"):
            self.assertEqual((accuracy["missing"], accuracy["extra"], accuracy["max_ulp"], accuracy["count_max"]), (0, 0, 0, 0))
            self.assertFalse(accuracy["asymmetric"])
        if result["kind"] == "approximate":
            self.assertGreater(accuracy["missing"], 0, name)
            self.assertGreater(accuracy["density_max"], 0, name)

    def test_file_and_options(self):
        path = self.scene("block", 1000)
        pairs = self.report("search", path)["result"]["pairs"]
        for args in ([], ["--cell-size", "0.5"], ["-T", "1"], ["--shuffle", "5"]):
            report = self.report("bench", path, "--method", "ours-mask", "--repeat", "1", "--sample", "50", *args)
            self.assertEqual([r["pairs"] for r in report["results"]], [pairs])
            self.assertEqual(report["results"][0]["scene"], "block.vdb")
        self.assertRegex(self.succeeds("bench", path, "--repeat", "1").out, r"(?m)^ours-count +[0-9]+ ")

    def test_every_method_on_a_simulated_device(self):
        report = self.report("bench", "--scene", "block", "-n", "20000", "--repeat", "2", "--sample", "100", "--device",
                             "sim", "--device-memory", "800KB", "--csv", self.path("x.csv"), "--method", "ours,devices")
        families = ["in-core", "blocks", "blocks16", "blocks32", "blocks64", "both-cpu", "both-halo", "both-auto"]
        names = ["ours-index", "ours-mask", "ours-count", "ours-visit"]
        names += [f"{f}-{e}" for f in families for e in ("index", "mask")]
        by_name = {result["method"]: result for result in report["results"]}
        self.assertEqual(list(by_name), names)
        self.assertIs(report["all_agree"], True)
        self.assertIsNone(report["link"])
        self.assertEqual(len({result["pairs"] for result in by_name.values()}), 1)
        self.assertEqual(len({r["checksum"] for r in by_name.values()} - {None}), 1)
        for name, result in by_name.items():
            self.assertEqual(result["checksum"] is None, name in ("ours-count", "ours-visit"))
            self.assertEqual(result["accuracy"]["missing"] + result["accuracy"]["extra"], 0)
            if name.startswith("ours"):
                self.assertIsNone(result["device"])
            else:
                self.check_device(name, result)
        with open(self.path("x.csv")) as file:
            for row in csv.DictReader(file):
                device = by_name[row["method"]]["device"] or {}
                self.assertEqual(row["device_blocks"], str(device.get("blocks", "")))
                self.assertEqual(row["device_boundary"], device.get("boundary", ""))
                self.assertEqual(row["checksum"], by_name[row["method"]]["checksum"] or "")

    def check_device(self, name, result):
        device = result["device"]
        self.assertEqual((device["kind"], device["virtual"]), ("sim", True))
        self.assertEqual(device["in_core"], name.startswith("in-core"))
        self.assertEqual(device["budget_bytes"], 3 << 30 if device["in_core"] else 800000, name)
        self.assertLessEqual(device["peak_bytes"], device["budget_bytes"])
        self.assertEqual(device["device_particles"] + device["cpu_particles"], 20000)
        self.assertEqual(device["cpu_particles"] > 0, name.startswith("both"), name)
        self.assertEqual(device["neighbors_per_second"] is None, name.startswith("both"), name)
        self.assertEqual(device["blocks"] == 1, device["in_core"], name)
        for key in ("upload_seconds", "download_seconds", "bytes_up", "bytes_down"):
            self.assertEqual(device[key], 0, key)
        for key in ("up_gbs", "down_gbs", "kernel_gbs"):
            self.assertIsNone(device[key], key)
        for key in ("overflows", "retries", "splits", "halvings"):
            self.assertGreaterEqual(device[key], 0)
        for key in ("search_seconds", "makespan_seconds", "estimate_seconds", "candidate_tests", "particles_per_gib",
                    "model_tests_per_second"):
            self.assertGreater(device[key], 0, key)
        self.assertGreater(device["candidate_tests"], result["pairs"])
        seconds = result["seconds"]
        self.assertGreaterEqual(seconds["max"], seconds["grid"] + device["estimate_seconds"])
        if name.startswith("both"):
            self.assertAlmostEqual(device["over_lower_bound"] * device["lower_bound_seconds"],
                                   device["makespan_seconds"], delta=1e-9)
            self.assertGreaterEqual(device["over_lower_bound"], 0.9)
        else:
            self.assertIsNone(device["over_lower_bound"])

    def test_methods_of_blocks(self):
        args = ("bench", "--scene", "block", "-n", "30000", "--repeat", "1", "--sample", "20", "--device", "sim:2")
        report = self.report(*args, "--method", "blocks-count,blocks16-mask,both-auto-mask,in-core-count")
        by_name = {result["method"]: result["device"] for result in report["results"]}
        self.assertEqual([by_name[name]["in_core"] for name in by_name], [False, False, False, True])
        self.assertGreater(by_name["blocks16-mask"]["blocks"], 4)
        self.assertIsNone(by_name["both-auto-mask"]["lower_bound_seconds"]) # neither part was measured
        out = self.succeeds(*args, "--method", "blocks-mask,ours-mask").out
        self.assertRegex(out, r"(?m)^the 2 exact methods find the same pairs$")
        self.assertRegex(out, r"(?m)^on simulated, in virtual time$")
        self.assertEqual(len([line for line in out.splitlines() if line.startswith("blocks-mask")]), 3)

    def test_in_core_is_in_core(self):
        args = ("bench", "--scene", "block", "-n", "5000", "--repeat", "1", "--device", "sim", "--sim", "memory=100KB")
        self.fails(4, *args, "--method", "in-core-mask", says=["in-core-mask", "100000", "needs about"])
        report = self.report(*args, "--method", "blocks-mask", "--device-memory", "1GB")
        self.assertEqual([r["device"]["in_core"] for r in report["results"]], [True])

    def test_methods_and_devices_that_contradict(self):
        scene = ("bench", "--scene", "block", "-n", "100")
        self.fails(2, *scene, "--device", "sim", "--method", "ours-mask", says=["--device sim", "blocks-mask"])
        self.fails(2, *scene, "--device", "cpu", "--method", "in-core-mask", says=["in-core-mask", "--device cpu"])
        self.fails(2, *scene, "--device-memory", "1MB", says="--device-memory")
        self.fails(2, *scene, "--device", "sim", "--device-memory", "1MB", "--method", "in-core-mask",
                   says="--device-memory")
        self.fails(2, *scene, "--device", "sim", "--method", "mapped-mask", says=["mapped-mask", "CUDA"])
        self.fails(2, *scene, "--sim", "h200", says="--sim")
        self.fails(2, *scene, "--device", "cpu", "--sim", "h200", says="--sim")
        self.fails(2, *scene, "--device", "gpu", says="gpu")
        self.fails(2, *scene, "--device", "sim", "--device-memory", "much", says="--device-memory")
        for method in ("blocks", "blocks8-mask", "mask", "ours-", "both-mask", ""):
            self.fails(2, *scene, "--device", "sim", "--method", method, says="--method")

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
                     [path, "--study", "everything"], [path, "--study", "scaling", "--csv", self.path("b")],
                     [path, "--study", "methods", "--estimator", "all"], [path, "--chart", path, "-f"],
                     [path, "--method", "ours-index@9999"], [path, "--method", "nearest0"]):
            self.fails(2, "bench", *args)
        self.fails(3, "bench", self.path("missing.vdb"), says="missing.vdb")
        self.assertTrue(os.path.getsize(path) > 1000)

    def test_estimators(self):
        report = self.report("bench", "--scene", "block", "-n", "50000", "--method", "ours-count", "--repeat", "1",
                             "--sample", "0", "--estimator", "all")
        by_name = {entry["estimator"]: entry for entry in report["estimators"]}
        self.assertEqual(list(by_name),
                         ["paper:1e3", "paper:1e4", "paper:1e5", "paper", "uncorrected", "expected", "sampled:0.1", "sampled:1",
                          "sampled:3", "sampled:10", "counted", "fixed", "mask"])
        for name, entry in by_name.items():
            self.assertEqual(entry["scene"], "block")
            self.assertGreaterEqual(entry["seconds"], 0)
            self.assertLessEqual(abs(entry["bias"]), 0.15, name)
            self.assertLessEqual(entry["p50"], entry["p99"])
            self.assertLessEqual(entry["p99"], entry["max"])
        for name in ("counted", "mask"):
            for key in ("bias", "rmse", "p99", "overflow_rate"):
                self.assertEqual(by_name[name][key], 0)
            self.assertEqual(by_name[name]["reserved_over_used"], 1)
        self.assertLess(abs(by_name["expected"]["bias"]), abs(by_name["uncorrected"]["bias"]))
        self.assertEqual(by_name["counted"]["counted_queries"], 50000)
        self.expect_particle_errors(by_name)

    def expect_particle_errors(self, by_name):
        mean = self.report("search", self.scene("block", 50000))["result"]["mean"]
        for name, entry in by_name.items():
            keys = [entry[key] for key in ("particle_bias", "particle_rmse", "particle_correlation")]
            if name.split(":")[0] not in ("paper", "uncorrected", "fixed"):
                self.assertEqual(keys, [None, None, None], name)
        for name in ("paper", "uncorrected"):
            entry = by_name[name]
            self.assertAlmostEqual(entry["particle_bias"], entry["bias"] * mean, delta=1e-3 * mean)
            scatter = entry["particle_rmse"] ** 2 - entry["particle_bias"] ** 2
            self.assertGreater(scatter, 0)
            self.assertLess(scatter, by_name["fixed"]["particle_rmse"] ** 2)
            self.assertGreater(entry["particle_correlation"], 0.5)
            self.assertLess(entry["particle_correlation"], 1)
        self.assertAlmostEqual(by_name["fixed"]["particle_bias"], 0, delta=1e-4)
        self.assertIsNone(by_name["fixed"]["particle_correlation"])

    def test_estimators_as_text(self):
        out = self.succeeds("bench", "--scene", "spray", "-n", "2000", "--method", "ours-count", "--repeat", "1",
                            "--sample", "0", "--estimator", "uncorrected,expected,fixed").out
        table = out[out.index("of each particle"):].splitlines()[1:]
        self.assertEqual([line.split()[0] for line in table], ["estimator", "uncorrected", "fixed"])
        self.assertRegex(table[1], r"^uncorrected +[+-]\d+\.\d\d +\d+\.\d\d +0\.\d{4}$")
        self.assertRegex(table[2], r" -$")

    def test_estimators_of_a_list(self):
        args = ("bench", "--scene", "block", "-n", "2000", "--method", "ours-count", "--repeat", "1", "--sample", "0")
        self.assertEqual(self.report(*args)["estimators"], [])
        names = [entry["estimator"] for entry in self.report(*args, "--estimator", "fixed,mask")["estimators"]]
        self.assertEqual(names, ["fixed", "mask"])
        self.fails(2, *args, "--estimator", "guess", says=["--estimator", "guess", "expected"])
        self.fails(2, *args, "--estimator", "")

    def test_files(self):
        for args in (("--scene", "spray", "-n", "5000"), (self.scene("block"), "-g", "points"),
                     (self.npy("a.npy", np.random.default_rng(1).random((500, 3))), "-r", "0.1")):
            before = set(os.listdir(tempfile.gettempdir()))
            report = self.report("bench", *args, "--study", "files", "--repeat", "2")
            self.assertEqual({name for name in set(os.listdir(tempfile.gettempdir())) - before if "vdb_nns_bench" in name}, set())
            (entry,) = report["files"]
            seconds = entry["seconds"]
            self.assertEqual(seconds["openvdb_read"] is None, str(args[0]).endswith(".npy"))
            for step in ("read", "grid", "grid_of_array", "search", "copy", "whole"):
                self.assertGreater(seconds[step], 0, step)
            floor = seconds["copy"] + seconds["grid"] + seconds["search"]
            self.assertAlmostEqual(entry["whole_over_floor"], seconds["whole"] / floor)
            # indptr, indices and ones, and what is around them
            arrays = 8 * (entry["points"] + 1) + 5 * entry["pairs"]
            self.assertTrue(arrays < entry["output_bytes"] < arrays + 2000)
            text = self.succeeds("bench", *args, "--study", "files", "--repeat", "1").out
            self.assertRegex(text, r"files: search IN -o OUT\.npz")
        self.fails(2, "bench", *args, "--study", "files", "--shuffle", "1", says="--shuffle")

    def test_every_study(self):
        page = self.path("page.html")
        report = self.report("bench", "--scene", "dam_break", "-n", "4000", "--repeat", "1", "--study", "all", "--method",
                             "ours-index,filter-only,nearest8", "--chart", page)
        scene = {entry["scene"] for study in ("results", "estimators", "budgets", "resolution", "scaling", "model_share",
                                              "savings", "files") for entry in report[study]}
        self.assertEqual(scene, {"dam_break"})
        for study in ("radii", "nearest", "measures"):
            self.assertEqual({entry["scene"] for entry in report[study]}, {"dam_break"})
        self.assertEqual([round(100 * b["share"]) for b in report["budgets"]], 2 * [100, 50, 25, 10, 5, 2, 1])
        for budget in report["budgets"]:
            self.assertTrue(budget["model"])
            self.assertEqual(budget["outcome"] == "refused", bool(budget["message"]))
        self.assertEqual({r["encoding"] for r in report["resolution"]}, {"index", "mask", "none"})
        self.assertEqual(sum(r["chosen"] for r in report["resolution"]), 3)
        vary = {s["vary"] for s in report["scaling"]}
        self.assertEqual(vary, {"points", "threads", "radius", "clustering"})
        for entry in report["scaling"]:
            if entry["method"].startswith("ours"):
                self.assertEqual(entry["wrong_per_million"], 0)
        shares = {(s["encoding"], s["in_core"]): s for s in report["model_share"]}
        self.assertEqual(len(shares), 4)
        for (encoding, in_core), share in shares.items():
            seconds = share["seconds"]
            self.assertEqual(in_core, seconds["estimate"] + seconds["tree"] + seconds["schedule"] == 0)
            self.assertEqual(in_core, share["blocks"] == 0)
        with open(page) as file:
            text = file.read()
        self.assertIn("dam_break", text)
        self.assertIn("nearest8", text)

    def check_sets(self, rows):
        """Ours has no wrong pair, every column is there, and ratios are to ours."""
        for row in rows:
            self.assertEqual(set(row), {"scene", "radii", "mode", "method", "exact", "points", "queries", "runs", "nearest",
                                        "pairs", "seconds", "ratio", "accuracy", "message"})
            self.assertEqual(row["message"], "")
            self.assertEqual(row["runs"], 2)
            self.assertLessEqual(row["queries"], row["points"])
            seconds, accuracy = row["seconds"], row["accuracy"]
            self.assertLessEqual(seconds["min"], seconds["total"])
            self.assertLessEqual(seconds["total"], seconds["max"])
            self.assertTrue(accuracy["complete"])
            wrong = accuracy["missing"] + accuracy["extra"] + accuracy["duplicates"]
            self.assertAlmostEqual(accuracy["wrong_per_million"], 1e6 * wrong / accuracy["true_pairs"])
            self.assertEqual(row["exact"], row["method"] == "ours")
            if row["exact"]:
                self.assertEqual((wrong, row["ratio"], row["pairs"]), (0, 1, accuracy["true_pairs"]))

    def test_radii(self):
        table = self.path("x.csv")
        args = ("bench", "--scene", "block", "-n", "1500", "--study", "radii", "--repeat", "2")
        rows = self.report(*args, "--csv", table)["radii"]
        self.check_sets(rows)
        methods = {}
        for row in rows:
            self.assertIsNone(row["nearest"])
            methods.setdefault((row["radii"], row["mode"]), []).append(row["method"])
        self.assertEqual(list(methods), [(radii, mode) for radii in ("graded 1:100", "mixed 1:4")
                                         for mode in ("gather", "scatter", "symmetric")])
        for (_, mode), names in methods.items():
            self.assertEqual(names[:3], ["ours", "largest-filtered", "octaves"])
            if "nanoflann-k" in names:
                self.assertEqual("nanoflann" in names, mode == "gather")
        scatter, gather = ([row for row in rows if row["mode"] == mode and row["exact"]] for mode in ("scatter", "gather"))
        self.assertEqual([row["pairs"] for row in scatter], [row["pairs"] for row in gather])
        with open(table) as file:
            lines = list(csv.DictReader(file))
        self.assertEqual([line["method"] for line in lines], [row["method"] for row in rows])
        self.assertEqual([int(line["missing"]) for line in lines], [row["accuracy"]["missing"] for row in rows])
        out = self.succeeds(*args).out
        self.assertRegex(out, r"(?m)^radii graded 1:100, symmetric, \d+ particles$")
        self.assertRegex(out, r"(?m)^ours +\d+ +\d+ .* 1\.00 +0 +0 +0$")

    def test_nearest(self):
        path = self.scene("block", 2000) # a file is searched as it is
        args = ("bench", path, "--study", "nearest", "--repeat", "2")
        rows = self.report(*args)["nearest"]
        self.check_sets(rows)
        self.assertEqual([row["nearest"] for row in rows if row["exact"]], [1, 8, 32])
        for row in rows:
            self.assertEqual((row["radii"], row["mode"]), ("one", None))
            if row["method"] in ("full-cut", "nanoflann-cut"):
                self.assertEqual(row["accuracy"]["wrong_per_million"], 0)
        full = {row["pairs"] for row in rows if row["method"] == "full"}
        self.assertEqual(full, {self.report("search", path)["result"]["pairs"]})
        self.assertRegex(self.succeeds(*args).out, r"(?m)^nearest 32 within the radius, 2000 particles$")

    def test_sets_on_a_sample(self):
        for study in ("radii", "nearest"):
            args = ("bench", "--scene", "block", "-n", "3000", "--study", study, "--repeat", "1", "--sample")
            for row in self.report(*args, "100")[study]:
                self.assertEqual((row["accuracy"]["complete"], row["accuracy"]["checked_queries"]), (False, 100))
            self.assertIn("those of a sample", self.succeeds(*args, "100").out)
            for row in self.report(*args, "0")[study]:
                self.assertIsNone(row["accuracy"]["wrong_per_million"])

    def test_flags_of_sets(self):
        args = ("bench", "--scene", "block", "-n", "500", "--study")
        for study in ("radii", "nearest"):
            for flag, value in (("--method", "ours-index"), ("--device", "sim"), ("--estimator", "all")):
                self.fails(2, *args, study, flag, value, says="would change nothing here")
            self.fails(2, *args, "methods," + study, "--csv", self.path("x.csv"), says=["--csv is one table", "--json"])

    def test_measures(self):
        table = self.path("x.csv")
        args = ("bench", "--scene", "block", "-n", "3000", "--study", "measures", "--repeat", "2")
        rows = self.report(*args, "--csv", table)["measures"]
        methods = ["ours", "float32", "half", "nearest32", "fxpt16", "fxpt8"]
        self.assertEqual([(row["measure"], row["method"]) for row in rows],
                         [(measure, method) for measure in ("density", "normal", "pca") for method in methods])
        for row in rows:
            self.assertEqual(set(row), {"scene", "measure", "method", "exact", "points", "runs", "seconds", "ratio", "accuracy",
                                        "message"})
            self.assertEqual((row["scene"], row["points"], row["runs"], row["message"]), ("block", 3000, 2, ""))
            self.assertEqual(row["exact"], row["method"] == "ours")
            seconds, accuracy = row["seconds"], row["accuracy"]
            self.assertEqual(set(seconds), {"grid", "pass", "total", "min", "max", "counting"})
            self.assertLessEqual(seconds["min"], seconds["total"])
            self.assertLessEqual(seconds["total"], seconds["max"])
            self.assertAlmostEqual(row["ratio"], seconds["pass"] / seconds["counting"])
            self.assertEqual((accuracy["complete"], accuracy["checked_queries"]), (True, 3000))
            self.assertEqual(accuracy["unit"], "degrees" if row["measure"] == "normal" else "relative")
            self.assertEqual(accuracy["wrong"], 0 if row["exact"] else None)
            self.assertEqual(accuracy["axis"] is None, row["measure"] != "pca")
            for error in (accuracy, accuracy["axis"] or accuracy):
                self.assertGreater(error["compared"], 500)
                self.assertLessEqual(error["rms"], error["max"])
                self.assertLessEqual(error["p99"], error["max"])
            if row["exact"]:
                self.assertEqual(accuracy["one_sided"], 0)
            if (row["method"], row["measure"]) == ("half", "pca"):
                self.assertGreater(accuracy["one_sided"], 0)
        with open(table) as file:
            lines = list(csv.DictReader(file))
        for line, row in zip(lines, rows, strict=True):
            self.assertEqual((line["measure"], line["method"]), (row["measure"], row["method"]))
            for key in ("rms", "p99", "max"):
                self.assertAlmostEqual(float(line[key]) / row["accuracy"][key], 1, delta=1e-5)
            self.assertEqual(line["axis_rms"] == "", row["accuracy"]["axis"] is None)
        out = self.succeeds(*args).out
        self.assertRegex(out, r"(?m)^measures of 3000 particles; .*\nerrors of all 3000 queries; ")
        self.assertRegex(out, r"(?m)^density: relative error\nmethod .*\nours +0\.")
        self.assertRegex(out, r"(?m)^pca: .*\nmethod .* axis rms +99 % +max\nours +0\.")

    def test_measures_on_a_sample(self):
        args = ("bench", self.scene("block", 2000), "--study", "measures", "--repeat", "1", "--sample")
        for row in self.report(*args, "100")["measures"]:
            self.assertEqual((row["accuracy"]["complete"], row["accuracy"]["checked_queries"]), (False, 100))
        self.assertIn("errors of a sample of 100 queries", self.succeeds(*args, "100").out)
        for row in self.report(*args, "0")["measures"]:
            self.assertEqual((row["accuracy"]["compared"], row["accuracy"]["rms"]), (0, None))
        self.assertNotIn("errors of a", self.succeeds(*args, "0").out)

    def test_flags_of_measures(self):
        args = ("bench", "--scene", "block", "-n", "500", "--study")
        for flag, value in (("--method", "ours-index"), ("--device", "sim"), ("--estimator", "all")):
            self.fails(2, *args, "measures", flag, value, says="would change nothing here")
        for other in ("methods", "radii"):
            self.fails(2, *args, "measures," + other, "--csv", self.path("x.csv"), says=["--csv is one table", "--json"])

    def test_charts_without_matplotlib(self):
        page = self.path("page.html")
        result = cli_case.run(*CHART, page, env=cli_case.watched(VDB_NNS_NO_PROGRAMS="1"))
        self.assertEqual(result.code, 6)
        self.assertIn("python3-matplotlib", result.err)
        self.assertIn("ours-index", result.out) # the numbers still come
        self.assertFalse(os.path.exists(page))

    def test_charts_run_nothing_of_the_folder(self):
        """Neither when Python is looked for, nor when it draws."""
        marker = self.path("marker")
        for module in ("matplotlib", "numpy", "json", "argparse", "charts", "evil"):
            self.text(module + ".py", f"open({marker!r}, 'w')\nraise SystemExit(0)\n")
        self.text("matplotlibrc", "backend: module://evil\n")
        done = cli_case.run(*CHART, "page.html", cwd=self.folder)
        self.assertFalse(os.path.exists(marker))
        if done.code == 6 and "python3-matplotlib" in done.err:
            self.skipTest("drawing needs Matplotlib")
        self.assertEqual(done.code, 0, done.err)
        self.assertIn(b"</html>", self.bytes(self.path("page.html")))

    def test_stability(self):
        report = self.report("bench", "--stability", "--method", "ours-index,world-float,brute-force,blocks-mask", "-T", "2")
        self.assertEqual(report["results"], [])
        cells = {(cell["case"], cell["method"]): cell for cell in report["stability"]}
        self.assertGreater(len({case for case, _ in cells}), 60)
        for (case, method), cell in cells.items():
            self.assertIn(cell["verdict"], ("exact", "wrong", "refused", "crash", "hang", "memory", "skipped"))
            self.assertEqual(cell["wrong_values"], 0, (case, method, cell["message"]))
            if method == "ours-index":
                self.assertIn(cell["verdict"], ("exact", "refused", "skipped"), (case, cell["message"]))
        self.assertTrue({"radii", "sets", "nearest", "measures"} < {cell["group"] for cell in report["stability"]})
        for case in ("radii-bad-scatter", "radii-1e4-symmetric", "sets-on-top", "groups-no-query", "nearest-equal"):
            self.assertEqual([cells[case, method]["verdict"] for method in ("ours-index", "world-float", "blocks-mask")],
                             ["exact", "skipped", "skipped"], case)
        for case in ("measures-sheet-tilted", "measures-values-largest", "measures-far-transform"):
            self.assertEqual([cells[case, method]["verdict"] for method in ("ours-index", "brute-force", "blocks-mask")],
                             ["exact", "skipped", "skipped"], case)
        self.assertEqual(cells["measures-mass-nan", "ours-index"]["verdict"], "refused")
        self.assertEqual(cells["radii-bad-gather", "brute-force"]["verdict"], "wrong") # a square forgets the sign
        self.assertEqual(cells["far-1e7", "world-float"]["verdict"], "wrong")
        self.assertEqual(cells["tie-0.1", "world-float"]["verdict"], "wrong")

    def test_too_large_for_full_truth_and_for_a_method(self):
        args = ("bench", "--scene", "coincident", "-n", "90000", "--method", "ours-count,ours-index", "--repeat", "1",
                "--host-memory", "2GB")
        count, index = self.report(*args)["results"]
        self.assertEqual(count["pairs"], 90000 * 89999)
        self.assertEqual((count["accuracy"]["complete"], count["accuracy"]["checked_queries"]), (False, 1000))
        self.assertEqual((count["accuracy"]["missing"], count["accuracy"]["extra"], count["message"]), (0, 0, ""))
        self.assertIn("allowed", index["message"])
        self.assertIsNone(index["seconds"]["total"])
        out = self.succeeds(*args).out
        self.assertRegex(out, r"(?m)^against the truth of a sample: 1000 queries")
        self.assertRegex(out, r"(?m)^ours-index refused: index lists need")

    def test_unchecked_is_not_exact(self):
        accuracy = self.report("bench", "--scene", "block", "-n", "500", "--method", "nearest8", "--repeat", "1", "--sample",
                               "0")["results"][0]["accuracy"]
        self.assertEqual((accuracy["checked_queries"], accuracy["missing_per_million"]), (0, None))

    def test_flags_that_nothing_heeds(self):
        for study, flag, value, says in (
                ("resolution", "--method", "nearest8", "--study methods"), ("resolution", "--device", "sim", "budgets"),
                ("resolution", "--cell-size", "1", "scaling"), ("resolution", "--sample", "10", "methods, scaling"),
                ("scaling", "--csv", self.path("x.csv"), "--study methods"), ("model", "--estimator", "all", "estimators"),
                ("estimators", "--sim", "h200", "model")):
            self.fails(2, "bench", "--scene", "block", "-n", "500", "--study", study, flag, value, says=[flag, says])
        for flag, value in (("--sample", "10"), ("--repeat", "3"), ("--shuffle", "1"), ("--points-out", self.path("p")),
                            ("-r", "1"), ("-g", "points"), ("--host-memory", "1GB"), ("--device", "sim"),
                            ("--cell-size", "1"), ("--estimator", "all"), ("--csv", self.path("x.csv")), ("--seed", "2")):
            self.fails(2, "bench", "--stability", flag, value, says=["would change nothing here", "--study"])
        path = self.scene()
        for flag, value in (("-n", "10"), ("--spacing", "2"), ("--radius-factor", "3"), ("--voxel-size", "1"), ("--offset", "1e3"),
                            ("--distance", "1e3"), ("--fraction", "0.5")):
            self.fails(2, "bench", path, flag, value, says="is for --scene")
            self.fails(2, "bench", "--stability", flag, value, says="is for --scene")
